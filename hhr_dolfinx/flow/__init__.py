"""Bodies that flow: strain at Gauss points, constitutive updates, and the loop over time steps. Arrays, no mesh."""
