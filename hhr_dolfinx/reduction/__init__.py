"""From snapshots to a checked reduced model: recipe, basis, RID, enrichment, projection, build."""
