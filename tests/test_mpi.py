"""The same numbers on 1, 2 and 3 ranks."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

TESTS = Path(__file__).parent
PROGRAM = """
import json, sys
sys.path[:0] = [{tests!r}, {demos!r}]
import numpy as np
import contact_patch_test as patch
import hertz_half_discs as demo
from scenes import pressed_block
import hhr_dolfinx as hhr
out = {{}}
full_order = hhr.FullOrderModel(demo.scene())
for mu in (0.15, 0.3123, 0.45):
    solution = full_order.solve(mu)
    out[f"forces {{mu}}"] = solution.forces.tolist()
    out[f"norm {{mu}}"] = float(np.linalg.norm(solution.primal))
snapshots = hhr.compute_snapshots(full_order, full_order.problem.parameters.grid([31]))
reduction = hhr.build_reduced_model(full_order, snapshots, demo.THESIS)
out["reduced"] = np.linalg.norm(reduction.solve_everywhere(0.3123)[0])
out["solid"] = hhr.FullOrderModel(pressed_block("solid", simplices=True)).solve(0.05).forces.tolist()
for name, pairing in patch.PAIRINGS.items():
    for dim in (2, 3):
        cells = ((4, 3), (7, 3)) if dim == 2 else ((2, 2, 2), (3, 3, 2))
        turned = patch.scene(pairing, *cells, poisson=0.3, angle=1.0, bulge=0.04, by_normal=dim == 2)
        model = hhr.FullOrderModel(turned)
        out[f"{{name}} {{dim}} gaps"] = model.problem.gaps[:, 0].tolist()
        out[f"{{name}} {{dim}} rows"] = np.ravel(abs(model.problem.contact).sum(axis=1)).tolist()
        out[f"{{name}} {{dim}} forces"] = model.solve([0.09, 0.03]).forces.tolist()
if full_order.comm.rank == 0:
    print(json.dumps(out))
"""


def launch(ranks, arguments, cwd=None):
    """Output of a Python program on some ranks."""
    beside = str(Path(sys.executable).parent)
    mpirun = shutil.which("mpirun", path=os.pathsep.join([beside, os.environ["PATH"]]))
    if mpirun is None:
        pytest.skip("no mpirun beside this Python or on the PATH")
    # Open MPI refuses root and more ranks than cores unless told otherwise; MPICH ignores these
    allow = {
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "OMPI_MCA_rmaps_base_oversubscribe": "1",
        "PRTE_MCA_rmaps_default_mapping_policy": ":oversubscribe",
        "OMP_NUM_THREADS": "1",
        "COLUMNS": "200",
    }
    command = [mpirun, "-n", str(ranks), sys.executable, *arguments]
    run = subprocess.run(command, capture_output=True, text=True, env=os.environ | allow, timeout=300, cwd=cwd)
    assert run.returncode == 0, run.stdout[-2000:] + run.stderr[-3000:]
    return run.stdout


def run_on(ranks):
    program = PROGRAM.format(tests=str(TESTS), demos=str(TESTS.parent / "demos"))
    return json.loads(launch(ranks, ["-c", program]).splitlines()[-1])


@pytest.fixture(scope="module")
def serial():
    return run_on(1)


@pytest.mark.parametrize("ranks", [2, 3])
def test_ranks_do_not_change_the_answer(serial, ranks):
    """Round-off only: 1e-10, since the factorisations order their sums differently."""
    parallel = run_on(ranks)
    assert parallel.keys() == serial.keys()
    for name, value in serial.items():
        if name == "reduced":  # dof numbers change what DEIM picks among mirror images: within the model error
            assert parallel[name] == pytest.approx(value, rel=1e-4)
        else:
            assert parallel[name] == pytest.approx(value, rel=1e-10, abs=1e-10 * np.max(np.abs(value)))


def test_a_study_on_two_ranks_is_that_on_one(tmp_path):
    """Ranks share the training; the first one measures and reports, with the same errors."""
    demo = str(TESTS.parent / "demos/hertz_half_discs.py")
    reports = []
    for ranks in (1, 2):
        launch(ranks, [demo, "--quick", "--out", str(tmp_path / str(ranks))])
        reports.append(json.loads((tmp_path / str(ranks) / "report.json").read_text()))
    assert [report["machine"]["ranks"] for report in reports] == [1, 2]
    # training points start from other statuses: round-off
    assert reports[1]["errors"]["primal_l2"]["max"] == pytest.approx(reports[0]["errors"]["primal_l2"]["max"], rel=1e-6)


def test_a_serial_demo_ends_on_other_ranks():
    """Past the options only the first rank is left, and the others end without an error."""
    program = (
        "from hhr_dolfinx.study import cli\n"
        "from mpi4py import MPI\n"
        "options = cli.parse_on_first_rank(cli.demo_parser('serial', 'A serial demo.'))\n"
        "print('rank', MPI.COMM_WORLD.rank, flush=True)\n"
    )
    assert launch(3, ["-c", "import hhr_dolfinx\n" + program]).split() == ["rank", "0"]
