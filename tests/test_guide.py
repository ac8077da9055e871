"""The guide's pages run, are found, and name everything that is public; the build itself is in .ci/run."""

import re
from pathlib import Path

import pytest

GUIDE = Path(__file__).parents[1] / "studies" / "guide"
PAGES = sorted(page for page in GUIDE.rglob("*.md"))
NAMES = [str(page.relative_to(GUIDE)) for page in PAGES]


def blocks(page, fence):
    """Programs of a page behind one kind of fence."""
    return re.findall(rf"^{fence}\n(.*?)^```$", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


@pytest.mark.parametrize("page", [page for page in PAGES if blocks(page, "```python")], ids=lambda page: page.stem)
def test_programs_of_a_page_run_one_after_the_other(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"__name__": "guide"}
    for program in blocks(page, "```python"):
        exec(compile(program, page.name, "exec"), names)
