# Two commands do everything: `make demo` and `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Tests wait about a third of their time: one more than there are cores keeps them busy.
JOBS ?= $(shell echo $$(( $$(nproc) + 1 )))
# A file's tests stay together, for they share what is dear to set up; the long files come first.
TOGETHER := --dist loadfile --no-loadscope-reorder
BESIDE := -n $(JOBS) $(TOGETHER)
PIP := $(BIN)/python -m pip --disable-pip-version-check

.DEFAULT_GOAL := help
.PHONY: help setup setup-dev demo test lint format types layers unit system-packages clean

help: ## show this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 18

$(BIN)/python:
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "Atrium needs Python 3.11 or newer, found " + sys.version.split()[0] + "; choose one with: make PYTHON=python3.12")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.run-stamp: pyproject.toml constraints.txt requirements-no-deps.txt | $(BIN)/python
	@echo "==> installing Atrium and what its services run on (a minute or two)"
	$(PIP) install --progress-bar on -c constraints.txt -e '.[all]'
	$(PIP) install --progress-bar on --no-deps -r requirements-no-deps.txt
	@touch $@

$(VENV)/.dev-stamp: $(VENV)/.run-stamp requirements-no-deps-bench.txt
	@echo "==> installing the test and benchmark tools"
	$(PIP) install --progress-bar on -c constraints.txt -e '.[all,dev,bench]'
	$(PIP) install --progress-bar on --no-deps -r requirements-no-deps-bench.txt
	@touch $@

setup: $(VENV)/.run-stamp ## create .venv with every service

setup-dev: $(VENV)/.dev-stamp ## the same, with test and benchmark tools

demo: setup ## run the main job: simulated hall, live map in the browser
	$(BIN)/atrium demo $(ARGS)

system-packages:
	@scripts/system-packages.sh

lint: setup-dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .

format: setup-dev ## format and mend what can be mended
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

types: setup-dev
	$(BIN)/mypy

layers: setup-dev
	$(BIN)/lint-imports

unit: setup-dev ## the quick tests only
	$(BIN)/pytest $(BESIDE) tests/unit tests/contract

test: setup-dev system-packages lint types layers ## set up and run every check and test, JOBS at a time
	$(BIN)/pytest $(BESIDE) -m 'not alone and not paced'
	$(BIN)/pytest -n 2 $(TOGETHER) -m paced
	$(BIN)/pytest -m alone

clean: ## remove the virtual environment and caches
	rm -rf $(VENV) .mypy_cache .ruff_cache .pytest_cache var
