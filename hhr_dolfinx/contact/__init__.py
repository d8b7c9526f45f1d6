"""The contact problem as arrays, and how it is solved: active set, dense blocks, condensation. No mesh, no physics."""
