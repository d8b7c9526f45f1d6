"""Facet ``report``: fields for viewers."""

from hhr_dolfinx.plugins.contact_laws.fields import FieldsOfMemory

REPORT = FieldsOfMemory("gaskets", "gasket_closure", "largest_closure")
