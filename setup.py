"""Scenarios and meshes stay in folders of their own at the top, and go into the package when it is built."""

from setuptools import find_namespace_packages, setup

DATA = {"forearm_fem._data.scenarios": "scenarios", "forearm_fem._data.meshes": "meshes"}

setup(
    packages=[*find_namespace_packages(include=["forearm_fem", "forearm_fem.*"]), *DATA],
    package_dir=DATA,
    package_data={
        "forearm_fem": [
            "**/*.mplstyle", "**/*.html.j2", "study/pages/**/*", "questions/predict/*.toml", "tissue_laws.json",
            "track_record.json", "show/workbench/page/*", "py.typed",
        ],
        "forearm_fem._data.scenarios": ["*.toml"],
        "forearm_fem._data.meshes": ["*.vtu", "*.json", "sample/*.stl"],
    },
)
