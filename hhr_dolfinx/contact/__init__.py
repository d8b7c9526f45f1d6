"""The contact problem as arrays, cut to a RID too, and its active set. No mesh, no physics."""
