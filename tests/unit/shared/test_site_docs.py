"""docs/site.md is tried by following it: its example loads and it names every key."""

import re
from pathlib import Path

import pytest
import yaml
from pydantic import BaseModel

from shared.site import load_site
from shared.site import site_file as parts

DOCS = (Path(__file__).resolve().parents[3] / "docs" / "site.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"```yaml\n(.*?)```", DOCS, re.S)


def test_the_example_loads_and_its_camera_hangs_where_the_text_would_have_it(tmp_path: Path) -> None:
    file = tmp_path / "site.yaml"
    file.write_text(EXAMPLES[0], encoding="utf-8")
    site = load_site(file)
    assert site.site == "museum"
    x, y, z = site.camera("lobby").geometry.build().position
    assert (x, y, z) == pytest.approx((1.0, 0.5, 3.4), abs=0.1)


def test_the_other_examples_are_yaml() -> None:
    assert len(EXAMPLES) == 3
    for example in EXAMPLES:
        assert yaml.safe_load(example)


@pytest.mark.parametrize(
    "part",
    [kind for kind in vars(parts).values() if isinstance(kind, type) and issubclass(kind, parts.Part)],
    ids=lambda kind: kind.__name__,
)
def test_every_key_is_in_the_reference(part: type[BaseModel]) -> None:
    for name in part.model_fields:
        assert re.search(rf"`[\w.\[\]]*\b{name}\b[^`\n]*`|`\.{name}`", DOCS), name


def test_the_newcomers_site_of_the_camera_set_up_loads(tmp_path: Path) -> None:
    page = (Path(__file__).resolve().parents[3] / "docs" / "camera-setup.md").read_text(encoding="utf-8")
    (example,) = re.findall(r"```yaml\n(.*?)```", page, re.S)
    file = tmp_path / "site.yaml"
    file.write_text(example, encoding="utf-8")
    assert load_site(file).camera("door").geometry.kind == "pose"
