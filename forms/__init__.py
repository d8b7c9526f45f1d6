"""The physics in UFL: small strain, loads, areas of contact surfaces, and the flow that tests hold the laws against."""
