"""Facet ``report``: fields for viewers."""

from hhr_dolfinx.plugins.contact_laws.fields import FieldsOfMemory

WEAR_FIELDS = FieldsOfMemory("wear", "worn_depth")
