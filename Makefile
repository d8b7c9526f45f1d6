# Two commands do everything on a fresh machine: `make demo` and `make test`.
# One thread per process: small problems get no faster by more, and times stay comparable.
export OMP_NUM_THREADS = 1
export OPENBLAS_NUM_THREADS = 1

.PHONY: demo test slow setup

demo: setup
	.venv/bin/python demos/hertz_half_discs.py

test: setup
	.venv/bin/python -m pytest

slow: setup
	.venv/bin/python -m pytest -m slow

setup:
	@sh scripts/setup.sh
