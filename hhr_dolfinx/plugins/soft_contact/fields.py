"""Facet ``report``: fields for viewers."""

from hhr_dolfinx.plugins.contact_laws.fields import FieldsOfMemory

SOFT_FIELDS = FieldsOfMemory("soft_contact", "overclosure")
