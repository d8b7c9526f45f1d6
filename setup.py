"""Finds the packages: hhr_dolfinx with its folders, forms and geometries.

All else stands in pyproject.toml.
"""

from setuptools import find_packages, setup

setup(
    packages=[
        *find_packages(include=["hhr_dolfinx", "hhr_dolfinx.*"]),
        "hhr_dolfinx.forms",
        "hhr_dolfinx.geometries",
    ]
)
