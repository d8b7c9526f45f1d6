"""Linear systems: dense blocks by PETSc or LAPACK, sparse stiffness by PETSc, and acceleration of
iterations.
"""
