"""The pages written by hand do not drift: every setting and every file that they name is there."""

import re
from pathlib import Path

import pytest
import yaml

from acgd.study.load import validated
from acgd.study.study import Study

ROOT = Path(__file__).parent.parent
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
SETTING = re.compile(r"`([a-z_]+(?:\.[a-z_]+)+): ([^`]+)`")
FILE = re.compile(r"`((?:acgd|workflow|scripts|benchmarks|tests|studies|docs)/[\w./-]+\.\w+)`")
LINK = re.compile(r"\]\(([^)#:]+)\)")


def found(pattern: re.Pattern[str]) -> list[tuple[str, ...]]:
    return [(page.name, *match.groups()) for page in PAGES for match in pattern.finditer(page.read_text())]


@pytest.mark.parametrize(("page", "key", "value"), found(SETTING))
def test_every_setting_can_be_set(page: str, key: str, value: str) -> None:
    content = yaml.safe_load(value)
    for name in reversed(key.split(".")):
        content = {name: content}
    validated(Study, content)


@pytest.mark.parametrize(("page", "file"), found(FILE))
def test_every_file_is_there(page: str, file: str) -> None:
    assert (ROOT / file).exists(), f"{page} names {file}"


@pytest.mark.parametrize(("page", "target"), found(LINK))
def test_every_link_leads_somewhere(page: str, target: str) -> None:
    folder = ROOT if page == "README.md" else ROOT / "docs"
    assert (folder / target).exists(), f"{page} links to {target}"


def test_the_code_column_of_the_deviations_names_files() -> None:
    page = (ROOT / "docs" / "deviations.md").read_text()
    named = re.findall(
        r"`((?:tasks|experts|critics|rollouts|vision|students|evaluation|reports|config)/[\w/]*(?:\.py)?)`", page
    )
    assert len(named) > 10
    assert [name for name in named if not (ROOT / "acgd" / name).exists()] == []
