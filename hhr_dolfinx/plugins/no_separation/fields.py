"""Facet ``report``: fields for viewers."""

from hhr_dolfinx.plugins.contact_laws.fields import FieldsOfMemory

HOLDING_FIELDS = FieldsOfMemory("no_separation", "held")
