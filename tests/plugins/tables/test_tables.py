"""Long tables: answered block by block, resumed where they were killed, one file in the end."""

import contract
import numpy as np
import pytest
from bare_problem import read_csv
from needs import needs, present
from processes import python
from rich.console import Console

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileError
from hhr_dolfinx.models import model as base
from hhr_dolfinx.plugins.tables.tables import TableRow, answer_table

ROWS = 23


@pytest.fixture(autouse=True)
def small_blocks(monkeypatch):
    """Blocks of five rows."""
    monkeypatch.setattr(base, "ROWS_AT_ONCE", 5)


@pytest.fixture(scope="module")
def model():
    return contract.model_of("HHR, moduli" if present("moduli") else "HHR, constant")


@pytest.fixture(scope="module")
def rows(model):
    points = model.parameters.random(ROWS, 3)
    points[7, 0] = np.nan
    return [
        TableRow(k + 2, [repr(value) for value in point]) for k, point in enumerate(points.tolist())
    ]


def quiet():
    return Console(record=True, width=300, file=open("/dev/null", "w"))


def killed(model, rows, target, resume="model"):
    """A run that is interrupted after two blocks."""

    def progress(items):
        yield from items[:2]
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        answer_table(model, rows, target, quiet(), progress, resume=resume)


def blocks_of(model, rows, target, resume="model"):
    """Blocks that a run answers."""
    seen = []

    def progress(items):
        seen.extend(items)
        return iter(items)

    answer_table(model, rows, target, quiet(), progress, resume=resume)
    return seen


@pytest.mark.parametrize("ending", [".csv", ".parquet"])
def test_a_table_that_was_killed_goes_on_where_it_was(ending, model, rows, tmp_path):
    whole, target = tmp_path / f"whole{ending}", tmp_path / f"a{ending}"
    assert answer_table(model, rows, whole, quiet()) == 1
    killed(model, rows, target)
    assert not target.exists() and (tmp_path / f"a{ending}.parts").is_dir()
    assert (
        blocks_of(model, rows, target) == [2, 3, 4] and not (tmp_path / f"a{ending}.parts").exists()
    )
    if ending == ".csv":
        assert (
            target.read_bytes() == whole.read_bytes()
            and len(target.read_text().splitlines()) == ROWS + 1
        )
    else:
        from pyarrow import parquet

        assert parquet.read_table(target).equals(parquet.read_table(whole))


def test_a_block_that_was_damaged_is_answered_again(model, rows, tmp_path):
    answer_table(model, rows, tmp_path / "whole.csv", quiet())
    killed(model, rows, tmp_path / "a.csv")
    block = tmp_path / "a.csv.parts" / "000000.csv"
    content = bytearray(block.read_bytes())
    content[-20] ^= 1
    block.write_bytes(content)
    assert blocks_of(model, rows, tmp_path / "a.csv") == [0, 2, 3, 4]
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()


@pytest.mark.parametrize("change", ["model", "row", "none"])
def test_blocks_of_another_model_or_table_are_not_taken(change, model, rows, tmp_path):
    killed(model, rows, tmp_path / "a.csv", "one")
    other = [*rows[:-1], rows[0]] if change == "row" else rows
    resume = {"model": "another", "row": "one", "none": None}[change]
    assert blocks_of(model, other, tmp_path / "a.csv", resume) == [0, 1, 2, 3, 4]


@pytest.mark.parametrize("resume", [None, "model"])
@pytest.mark.parametrize("name", ["thesis.tex", "000000.csv", "of.json"])
def test_a_folder_of_the_user_is_left_alone(name, resume, model, rows, tmp_path):
    """Refused before anything is answered, whatever it is called and holds: it has no mark of
    ours.
    """
    folder = tmp_path / "a.csv.parts"
    (folder / "deeper").mkdir(parents=True)
    (folder / name).write_text('"years of work"')
    with pytest.raises(
        FileError, match=r"a\.csv\.parts is where blocks of answers are kept .*: .*Move the folder"
    ):
        answer_table(model, rows, tmp_path / "a.csv", quiet(), pytest.fail, resume=resume)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv.parts"]
    assert (folder / name).read_text() == '"years of work"' and (folder / "deeper").is_dir()


@pytest.mark.parametrize("resume", [None, "another"])
def test_what_a_user_puts_beside_blocks_stays(resume, model, rows, tmp_path):
    """Blocks of an earlier run are removed one by one, and the folder only where nothing else is in
    it.
    """
    killed(model, rows, tmp_path / "a.csv")
    folder = tmp_path / "a.csv.parts"
    (folder / "note.txt").write_text("why")
    assert len(list(folder.iterdir())) == 6
    answer_table(model, rows, tmp_path / "a.csv", quiet(), resume=resume)
    assert [path.name for path in folder.iterdir()] == ["note.txt"] and (
        folder / "note.txt"
    ).read_text() == "why"
    assert len((tmp_path / "a.csv").read_text().splitlines()) == ROWS + 1


def test_an_empty_folder_is_as_good_as_none(model, rows, tmp_path):
    """As a run leaves it that is killed at its very beginning, with or without a file that it had
    begun.
    """
    (tmp_path / "a.csv.parts").mkdir()
    (tmp_path / "a.csv.parts" / "of.json.0123456789abcdef.part").write_text("")
    assert answer_table(model, rows, tmp_path / "a.csv", quiet(), resume="model") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.csv"]


@needs("moduli")
def test_estimates_are_left_out_where_nobody_asks(model, rows, tmp_path):
    answer_table(model, rows, tmp_path / "a.csv", quiet(), estimates=False)
    answer_table(model, rows, tmp_path / "b.csv", quiet())
    heads = [
        (tmp_path / name).read_text().splitlines()[0].split(",") for name in ("a.csv", "b.csv")
    ]
    assert [head for head in heads[1] if "bound of" not in head] == heads[0] and len(
        heads[1]
    ) == len(heads[0]) + 4


def test_many_bad_rows_are_counted_and_some_are_told(model, tmp_path):
    rows = [TableRow(k + 2, ["1e9"] * len(model.parameters.names)) for k in range(30)]
    console = quiet()
    assert answer_table(model, rows, tmp_path / "a.csv", console) == 30
    said = console.export_text()
    assert (
        said.count("is outside") >= 20
        and "and 10 more, with their reasons in the column 'status'" in said
    )
    assert (tmp_path / "a.csv").read_text().count("is outside") >= 30


def test_rows_in_blocks_are_those_of_one_by_one(model, rows, tmp_path):
    answer_table(model, rows, tmp_path / "a.csv", quiet())
    table = read_csv(tmp_path / "a.csv")
    for k in (0, 6, 8, 22):
        answer = model.solve([float(cell) for cell in rows[k].cells], outside="ignore")
        # 12 digits are written
        found = [float(table[k][f"force_{j}"]) for j in range(model.conditions)]
        assert found == pytest.approx(answer.forces(), rel=1e-10, abs=1e-10 * answer.forces().max())
        assert float(table[k]["force"]) == pytest.approx(answer.outputs()["force"], rel=1e-10)
    assert table[7]["status"] != "ok" and table[7]["force_0"] == ""


WITHOUT = """
import sys
missing = ["dolfinx_solver", "dolfinx", "ufl", "basix", "petsc4py", "mpi4py", "slepc4py"]
sys.modules.update(dict.fromkeys(missing))
from click.testing import CliRunner
from hhr_dolfinx.command.main import hhr as command
tables = ["answer", "m.npz", "q.csv", "--out", "a.csv"]
for words in (tables, ["solve", "m.npz", "--at", sys.argv[1]], ["train", "s.py"]):
    run = CliRunner().invoke(command, words, catch_exceptions=False)
    print(run.exit_code, run.output)
import hhr_dolfinx
try:
    hhr_dolfinx.train
except ImportError as error:
    print(type(error).__name__, error)
"""


def test_commands_without_dolfinx(model, rows, tmp_path):
    """Files answer; what needs DOLFINx says how to get it."""
    hhr.save_model(tmp_path / "m.npz", model)
    names = model.parameters.names
    (tmp_path / "q.csv").write_text(
        "\n".join([",".join(names), *(",".join(row.cells) for row in rows[:3])]) + "\n"
    )
    at = ",".join(f"{name}={cell}" for name, cell in zip(names, rows[0].cells, strict=True))
    run = python("-c", WITHOUT, at, cwd=tmp_path)
    assert "3 answers and 0 bad rows" in run.stdout and "largest displacement" in run.stdout
    assert "3 error: DOLFINx is not installed (no module mpi4py)" in run.stdout
    assert (
        "MissingPackageError DOLFINx is not installed" in run.stdout
        and "hhr_dolfinx[solver]" in run.stdout
    )
