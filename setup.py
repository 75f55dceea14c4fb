"""Which folders make the package; everything else stands in pyproject.toml."""

from setuptools import find_packages, setup

# The trained experts are installed as acgd/zoo, where acgd/experts/zoo.py looks first.
setup(
    packages=[*find_packages(include=["acgd", "acgd.*"]), "acgd.zoo"],
    package_dir={"acgd.zoo": "zoo"},
    package_data={"acgd.zoo": ["**/*"]},
)
