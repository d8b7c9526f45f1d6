"""Doors to other programs: a model as what they take, one file each, whose package is an extra of its own."""
