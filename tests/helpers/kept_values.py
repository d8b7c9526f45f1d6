"""Trees and arrays of files of models, changed for tests and signed anew."""

import json

import numpy as np
from bare_problem import rewrite_signed

from hhr_dolfinx.plain import _Reader


def node_of(tree, path):
    """The part of a tree at a path, ``fields.amplitudes.nonaffine.0.extent``."""
    for name in path.split("."):
        tree = tree["fields"] if isinstance(tree, dict) and "fields" in tree else tree
        tree = tree[int(name)] if isinstance(tree, list) else tree[name]
    return tree


def put(path, value):
    """Another value at a path; the arrays of the old one that nothing else names go."""

    def change(tree, arrays):
        before, _, name = path.rpartition(".")
        parent = node_of(tree, before) if before else tree
        parent = parent["fields"] if isinstance(parent, dict) and "fields" in parent else parent
        parent[int(name) if isinstance(parent, list) else name] = value
        tidy(tree, arrays)

    return change


def array(path, function):
    """Another array at a path; others that were the same stay as they are."""

    def change(tree, arrays):
        node = node_of(tree, path)
        found = _Reader(arrays, {}).value(node, path, None, 0)
        new = np.asarray(function(found.copy()))
        arrays[f"new.{path}"] = new
        put(path, {"array": f"new.{path}"})(tree, arrays)

    return change


def entry(path, index, value):
    """One entry of an array."""

    def changed(values):
        values[index] = value
        return values

    return array(path, changed)


def both(*changes):
    return lambda tree, arrays: [change(tree, arrays) for change in changes]


def tidy(tree, arrays):
    """Drop arrays that a tree does not name."""
    named = json.dumps(tree)
    for name in list(arrays):
        stem = name.removesuffix(".places").removesuffix(".values")
        if f'"{name}"' not in named and f'"{stem}"' not in named:
            del arrays[name]


def rewrite_model(path, change):
    """Change the tree and the arrays of a file of a model, and give it a valid checksum."""
    rewrite_signed(path, lambda header, arrays: change(header["model"], arrays))
