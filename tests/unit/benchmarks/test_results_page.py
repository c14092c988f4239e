from benchmarks.results_page import PAGE, render


def test_the_results_page_says_what_the_stored_results_say() -> None:
    assert PAGE.read_text(encoding="utf-8") == render(), "run: python -m benchmarks.results_page"
