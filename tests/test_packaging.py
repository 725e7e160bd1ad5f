import ast
import configparser
import re
import sys
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]


def declared(*sections):
    """The distributions, in canonical spelling, that setup.cfg names in these options."""
    config = configparser.ConfigParser()
    config.read(ROOT / "setup.cfg")
    lines = "\n".join(config[section][option] for section, option in sections).splitlines()
    return {canonical(re.match(r"[\w.-]+", line.strip())[0]) for line in lines if line.strip()}


def canonical(name):
    return re.sub(r"[-_.]+", "-", name).lower()


# Those parts of the package that its optional requirements are for.
OPTIONAL = ("clcache/experiments", "clcache/cli/experiment.py", "clcache/cli/tradeoff.py")


def third_party_imports(folder, only_at_the_top=False, without=()):
    """(module, file) of what the folder's files import from neither Python nor the project."""
    own = {"clcache"} | {file.stem for part in ("tests", "tools") for file in (ROOT / part).rglob("*.py")}
    for file in (ROOT / folder).rglob("*.py"):
        if str(file.relative_to(ROOT)).startswith(without):
            continue
        tree = ast.parse(file.read_text())
        for node in tree.body if only_at_the_top else ast.walk(tree):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom) and node.level == 0:
                names = [node.module]
            for module in {name.partition(".")[0] for name in names} - own - sys.stdlib_module_names:
                yield module, file.relative_to(ROOT)


@pytest.mark.parametrize(
    ("imports", "sections"),
    [
        (third_party_imports("clcache", without=OPTIONAL), [("options", "install_requires")]),
        (
            third_party_imports("clcache"),
            [
                ("options", "install_requires"),
                *(("options.extras_require", extra) for extra in ("experiments", "peers", "oidn")),
            ],
        ),
        (
            third_party_imports("tests", only_at_the_top=True),
            [("options", "install_requires"), ("options.extras_require", "test")],
        ),
    ],
    ids=["package", "experiments", "tests"],
)
def test_what_is_imported_is_declared(imports, sections):
    allowed, distributions = declared(*sections), packages_distributions()
    imported = dict(imports)
    assert "numpy" in imported
    undeclared = {
        module: str(file)
        for module, file in imported.items()
        if not {canonical(name) for name in distributions.get(module, [module])} & allowed
    }
    assert undeclared == {}


def test_every_requirement_of_the_package_is_used():
    distributions = packages_distributions()
    used = {
        canonical(name) for module, _ in third_party_imports("clcache") for name in distributions.get(module, [module])
    }
    assert declared(("options", "install_requires")) <= used
