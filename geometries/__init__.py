"""Geometries: functions of a communicator that return ``(mesh, cell_tags, facet_tags)``."""
