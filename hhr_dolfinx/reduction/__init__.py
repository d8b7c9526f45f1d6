"""From snapshots to a reduced model that can be trusted: recipe, basis, RID, enrichment, projection, build."""
