"""From snapshots to a reduced model that can be trusted: basis, RID, projection, enrichment, stability."""
