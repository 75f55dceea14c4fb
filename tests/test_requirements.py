"""requirements.txt names what the package imports, and requirements.lock agrees with it."""

import ast
import re
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

ROOT = Path(__file__).parent.parent
PIN = re.compile(r"^([A-Za-z0-9._-]+)==(\S+)$", re.MULTILINE)


def pins(name: str) -> dict[str, str]:
    return {normal(package): version for package, version in PIN.findall((ROOT / name).read_text())}


def normal(package: str) -> str:
    return re.sub(r"[-_.]+", "-", package).lower()


def imported(folder: str) -> set[str]:
    """Top-level names of all third-party imports, those inside functions too."""
    names = set()
    for file in (ROOT / folder).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and not node.level:
                names.add(node.module)
    return {name.split(".")[0] for name in names} - set(sys.stdlib_module_names) - {"acgd", "benchmarks", "tests"}


def test_direct_dependencies_stand_in_the_lock_with_the_same_version() -> None:
    lock = pins("requirements.lock")
    assert {package: lock.get(package) for package in pins("requirements.txt")} == pins("requirements.txt")
    assert {"pip", "setuptools"} <= set(lock)


def test_everything_imported_is_a_direct_dependency() -> None:
    distributions, direct = packages_distributions(), pins("requirements.txt")
    lacking = {
        name
        for name in imported("acgd") | imported("benchmarks")
        if not {normal(d) for d in distributions.get(name, [])} & set(direct)
    }
    assert lacking == set()
