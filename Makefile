# Two commands do everything on a fresh machine: `make demo` and `make test`.
# One thread per process: small problems get no faster by more, and times stay comparable.
export OMP_NUM_THREADS = 1
export OPENBLAS_NUM_THREADS = 1
# what is said comes as it is said, into a file or a pipe too
export PYTHONUNBUFFERED = 1
# set-up leaves compiling to the first import, which must be kept: else each of hundreds of processes compiles again
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo flange hertz pellet nonmatching plastic sphere materials rod press preload power torque fretting punch friction calibrate certified local indicator time-errors greedy indent scene held foreign foreign-codes benchmarks decks patch laws extreme recipes compose thesis rivals data-set figures pictures lint test test-core quick slow slice docs setup mutants doctor without same paths

demo: setup
	.venv/bin/python demos/bolted_joint.py

# from a STEP file by the commands of a user, one to three minutes
flange: setup
	.venv/bin/python demos/flange.py

# the cases of the thesis
hertz: setup
	.venv/bin/python benchmarks/thesis/hertz_half_discs.py

pellet: setup
	.venv/bin/python benchmarks/thesis/pellet_cladding.py --study thesis

nonmatching: setup
	.venv/bin/python benchmarks/thesis/pellet_cladding_nonmatching.py

plastic: setup
	.venv/bin/python benchmarks/thesis/pellet_cladding_plastic.py

sphere: setup
	.venv/bin/python demos/sphere_on_block.py

materials: setup
	.venv/bin/python benchmarks/thesis/pellet_materials.py

rod: setup
	.venv/bin/python demos/fuel_rod.py

fretting: setup
	.venv/bin/python demos/fretting.py

punch: setup
	.venv/bin/python demos/sliding_punch.py

preload: setup
	.venv/bin/python demos/bolt_preload.py

power: setup
	.venv/bin/python demos/pellet_power.py

torque: setup
	.venv/bin/python demos/press_fit_torque.py

friction: setup
	.venv/bin/python benchmarks/friction.py

press: setup
	.venv/bin/python demos/press_fit.py

calibrate: setup
	.venv/bin/python demos/calibrate.py

certified: setup
	.venv/bin/python benchmarks/certified.py

local: setup
	.venv/bin/python benchmarks/local_models.py

time-errors: setup
	.venv/bin/python benchmarks/time_errors.py

indicator: setup
	.venv/bin/python benchmarks/history_indicator.py

greedy: setup
	.venv/bin/python benchmarks/greedy_training.py

indent: setup
	.venv/bin/python demos/indentation.py

scene: setup
	.venv/bin/python demos/your_scene.py

# K of CalculiX' shells, contact of ours
foreign: setup
	.venv/bin/python demos/foreign.py

# elements of CalculiX that we lack, beside its own contact, where it is installed
foreign-codes: setup
	.venv/bin/python benchmarks/foreign.py

held: setup
	.venv/bin/python demos/held_by_contact.py

benchmarks: setup
	.venv/bin/python benchmarks/benchmarks.py

patch: setup
	.venv/bin/python benchmarks/contact_patch_test.py

laws: setup
	.venv/bin/python benchmarks/laws.py

# errors and times of condensed models on unseen load paths, twenty minutes on an idle core
paths: setup
	.venv/bin/python benchmarks/unseen_paths.py

# small decks and files of strangers, beside CalculiX and closed forms; nine minutes
decks: setup
	.venv/bin/python benchmarks/decks.py

extreme: setup
	.venv/bin/python benchmarks/extreme_cases.py

recipes: setup
	.venv/bin/python benchmarks/random_recipes.py

# all capabilities of the plug-ins in pairs and in all verbs, into docs/composition.md; two hours on two idle cores.
# A run that was ended goes on where it was
compose: setup
	.venv/bin/python benchmarks/compose.py --pairs --workers 2
	.venv/bin/python benchmarks/compose.py --docs

# each figure and table of the thesis beside ours, into docs/thesis.md; half an hour on an idle core
thesis: setup
	.venv/bin/python benchmarks/thesis/side_by_side.py --docs

# models of other authors, regressions and ours on ten scenes, into docs/rivals.md; an hour on an idle core
rivals: setup
	.venv/bin/python benchmarks/rivals.py --docs

# a data set of six contact problems that others can enter, and its hidden answers, into out/data_set; a minute or two
data-set: setup
	.venv/bin/python benchmarks/data_set.py

# all figures of README into docs/figures.json and README, an hour on an idle core
figures: setup
	.venv/bin/python benchmarks/figures.py

# the pictures of docs/ from demos and pages, some by ONLY="flange page"; pages where Chromium is. A test names the stale ones
pictures: setup
	.venv/bin/python scripts/pictures.py $(ONLY)

# style, formatting and types: what continuous integration asks first
lint: setup
	.venv/bin/python -m ruff check .
	.venv/bin/python -m ruff format --check .
	.venv/bin/python -m mypy

test: setup
	@echo "About eight minutes on two idle cores, three times as long on busy ones; dots come as tests are done."
	.venv/bin/python -m pytest -n auto --maxprocesses 4 --dist loadfile

QUICK = active_set bad_input bad_meshes enrichment formulas forms full_order house \
  laws_of_bodies loads many mesh_files model_files peers plain reduced registry sampling stability timing trust
QUICK_PLUGINS = plots/test_fields exact_errors/test_bounds greedy/test_restriction inelastic/test_cubature \
  elasticity/test_locking inelastic/test_history_files inelastic/test_laws local_models/test_subspaces moduli/test_interpolation \
  nonmatching/test_bad_pairings paths/test_path_families ranks/test_rows studies/test_pictures

# for people at work: each room of the house, and that what was installed works, in less than a minute
quick: setup
	.venv/bin/python -m pytest -n auto --maxprocesses 2 --dist loadfile $(QUICK:%=tests/core/test_%.py) \
	  $(wildcard $(QUICK_PLUGINS:%=tests/plugins/%.py))

# the core's tests that need no plug-in, without slow ones: two minutes
test-core: setup
	.venv/bin/python -m pytest -n auto --maxprocesses 4 --dist loadfile \
	  -m "not slow and not needs" tests/core

# all other tests, in a copy of the checkout without a plug-in: make without PLUGIN=pages
without: setup
	.venv/bin/python scripts/without.py $(PLUGIN)

# what `make test` leaves out: tests that take minutes, and the dear cases of tests/slow_cases.txt; half an hour.
# tests/slow_report.json keeps how each file ended
slow: setup
	.venv/bin/python -m pytest -m slow --record=tests/slow_report.json -n auto --maxprocesses 4 --dist worksteal

# one of twenty parts of these tests, chosen by the commit: what none of the others sees is seen a few commits later
SLICE = $(shell echo $$((0x$$(git rev-parse --short=6 HEAD 2>/dev/null || echo 0) % 20)))/20
slice: setup
	.venv/bin/python -m pytest -m slow --slice=$(SLICE) -n auto --maxprocesses 4 --dist worksteal

# rules of studies and certify are changed one at a time, and changes that no test sees are printed: an hour
mutants: setup
	.venv/bin/python scripts/mutants.py

# answers, gradients, marches and files of all kinds of models, bit by bit, beside those of a commit: BASE=main, or that
# of scripts/same_base.txt; five minutes on an idle core. A tree with the .venv of another one leaves that as it is
same:
	@BASE="$(BASE)" ALLOW="$(ALLOW)" ONLY="$(ONLY)" sh scripts/same.sh

setup:
	@sh scripts/setup.sh

# which of DOLFINx, PETSc, MUMPS, gmsh and the programs of the tests are there, and what they lack
doctor: setup
	@.venv/bin/python -m hhr_dolfinx.plugins.scene_checks.doctor

# the site in out/site: tutorial, gallery, reference; its examples are run, and a warning is an error
docs: setup
	.venv/bin/python -c "import furo, myst_nb, sphinx_copybutton, sphinx_gallery" 2>/dev/null || .venv/bin/python -m pip install --quiet --disable-pip-version-check --editable ".[docs]"
	.venv/bin/python -m sphinx --quiet --keep-going -W --builder html docs out/site
	@echo "the site: out/site/index.html"
