"""Capabilities beside the core, one folder each: any of them can be deleted without the core
noticing.
"""
