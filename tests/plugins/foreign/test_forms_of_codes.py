"""Numbers of our own in the forms in which codes write them, as files of public repositories show.

Each test names the file that has the form. Those files were read too, and compared with other
readers and with rigid motions, see docs/foreign.md.
"""

import numpy as np
import pytest

import hhr_dolfinx as hhr
from hhr_dolfinx.errors import FileContentError
from hhr_dolfinx.plugins.foreign.op4 import read_matrices

SUBSTRUCTURE = """**
** GENERATION OF SUBSTRUCTURE Z1      
*USER ELEMENT, NODES=         4, LINEAR
** ELEMENT NODES
**          3,          8,         -1,         -2
** NODE NUMBERS WHICH ARE NOT POSITIVE INDICATE Abaqus INTERNAL NODES.
          1,          2
          3,          1
*MATRIX,TYPE=STIFFNESS
  50.000000000000    ,
 -.25000000000000    ,  40.000000000000    
 -10.000000000000    ,  0.0000000000000    ,  50.000000000000    
  0.0000000000000    , -40.000000000000    , -.25000000000000    ,  40.000000000000    
  0.0000000000000    ,  0.0000000000000    ,  0.0000000000000    ,  0.0000000000000    
  219869.50000000    ,
  0.0000000000000    ,  0.0000000000000    ,  0.0000000000000    ,  0.0000000000000    
  0.0000000000000    ,  881000.25000000    
*MATRIX,TYPE=MASS
 0.33567024368285E-01,
"""
ELEMENT = """**
** ELEMENT NUMBER 11 STEP NUMBER 2 INCREMENT NUMBER 1
** ELEMENT TYPE T2D2
*USER ELEMENT, NODES=         2, LINEAR
** ELEMENT NODES
**        101,        102
          1
*MATRIX,TYPE=STIFFNESS
  2.0000000000000    ,
 -2.0000000000000    ,  2.0000000000000    
"""
HARWELL_BOEING = """\
Stiffness matrix from ANSYS FULL file dumped into Harwell-Boeing format         
            14             4             5             5             0
RSA                        3             3             5             0
(I14)           (I14)           (d25.15)            (d25.15)            
             1
             3
             5
             6
             1
             2
             2
             3
             3
    0.200000000000000D+11
   -0.100000000000000D+10
    0.300000000000000D+11
   -0.250000000000000D+10
    0.400000000000000D+11
"""
MAPPING = """\
    Matrix Eqn          Node    DOF     
             1             5    UX  
             2             5    ROTZ
             3             9    UY  
"""
OUTPUT4 = """\
       2       2       6       2KXX     1P,3E23.16
       1       0       5
    327681
 2.5000000000000000E+01-1.5000000000000000E+00
       2       0       5
    327681
-1.5000000000000000E+00 3.0000000000000000E+01
       3       1       1
 1.0000000000000000E+00
       2       2       6       4K4XX    1P,3E23.16
       1       1       4
 1.0000000000000000E+00 2.0000000000000000E+00 0.0000000000000000E+00
-1.0000000000000000E+00
       3       1       1
 1.0000000000000000E+00
       2       2       6       1MXX     1P,3E23.16
       2       2       1
 5.0000000000000000E-01
       3       1       1
 1.0000000000000000E+00
"""


def test_retained_modes_of_abaqus(tmp_path):
    """Retained modes have negative nodes; substructure.mtx of DICLab/MatlabAbaqus (Datos)."""
    (tmp_path / "part.mtx").write_text(SUBSTRUCTURE)
    found = hhr.read_stiffness(tmp_path / "part.mtx")
    assert found.superelement and found.nodes.tolist() == [3, 3, 8, 8, -1, -2]
    assert found.directions.tolist() == [1, 2, 1, 2, 0, 0]
    modes = [219869.5, 881000.25]
    assert np.array_equal(found.matrix.diagonal(), [50.0, 40.0, 50.0, 40.0, *modes])
    assert [found.matrix[0, 1], found.matrix[2, 0], found.matrix[3, 1]] == [-0.25, -10.0, -40.0]
    assert found.matrix.nnz == 14


def test_matrices_of_several_elements_are_refused(tmp_path):
    """``*ELEMENT MATRIX OUTPUT`` writes the same form for each element, as the page "How to export
    matrices from Abaqus" of 2016-04-07 shows it.
    """
    (tmp_path / "part.mtx").write_text(2 * ELEMENT)
    with pytest.raises(FileContentError, match="matrices of 2 elements"):
        hhr.read_stiffness(tmp_path / "part.mtx")


@pytest.mark.parametrize("load", [False, True])
def test_harwell_boeing_of_ansys(load, tmp_path):
    """Formats without a repeat count, a format of a load that is not there, and exponents with D;
    STIFF_ANSYS.hb of fjramireg/StiffMa (tests/Verification (vs ANSYS)/ANSYS_vrst), release 17.1.
    """
    lines = HARWELL_BOEING.splitlines()
    if load:
        lines[1] = f"{lines[1][:56]}{3:14d}"
        lines.insert(4, "F                          1             0")
        lines += ["    0.100000000000000D+01"] * 3
    (tmp_path / "part.matrix").write_text("\n".join(lines) + "\n")
    (tmp_path / "part.mapping").write_text(MAPPING)
    found = hhr.read_stiffness(tmp_path / "part.matrix")
    assert found.nodes.tolist() == [5, 5, 9] and found.directions.tolist() == [1, 6, 2]
    whole = [[20e9, -1e9, 0.0], [-1e9, 30e9, -2.5e9], [0.0, -2.5e9, 40e9]]
    assert np.array_equal(found.matrix.toarray(), whole)


def test_numbers_of_harwell_boeing_that_run_together(tmp_path):
    """Negative numbers that fill their fields leave no blank between them."""
    lines = HARWELL_BOEING.replace("(d25.15)", "(2D22.15)", 1).splitlines()
    words = [f"{line.strip():>22}" for line in lines[13:]]
    lines[1] = f"{lines[1][:42]}{3:14d}{0:14d}"
    lines[13:] = ["".join(words[k : k + 2]) for k in range(0, 5, 2)]
    (tmp_path / "part.hb").write_text("\n".join(lines) + "\n")
    (tmp_path / "part.mapping").write_text(MAPPING)
    found = hhr.read_stiffness(tmp_path / "part.hb").matrix
    assert [found[0, 0], found[1, 0], found[2, 1]] == [20e9, -1e9, -2.5e9]


def test_text_of_nastran_with_several_matrices(tmp_path):
    """A complex matrix and others beside K; se_test_n11.op4 of SteveDoyle2/pyNastran
    (models/superelements/se_test_static/incl/se) and double_nonbigmat_ascii.op4 of twmacro/pyyeti
    (pyyeti/tests/nastran_op4_data).
    """
    path = tmp_path / "part.op4"
    path.write_text(OUTPUT4)
    matrices = read_matrices(path)
    assert list(matrices) == ["KXX", "K4XX", "MXX"]
    assert np.array_equal(matrices["K4XX"].toarray(), [[1 + 2j, 0], [-1j, 0]])
    assert np.array_equal(matrices["MXX"].toarray(), [[0, 0], [0, 0.5]])
    (tmp_path / "part.dof").write_text("3.1\n1995001.0\n")
    found = hhr.read_stiffness(path)
    assert np.array_equal(found.matrix.toarray(), [[25.0, -1.5], [-1.5, 30.0]])
    assert found.directions.tolist() == [1, 0]
    with pytest.raises(FileContentError, match="K4XX is complex"):
        hhr.read_stiffness(path, matrix="K4XX")


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("form", ["full", "sparse", "big"])
def test_binary_of_nastran_with_integers_of_eight_bytes(form, order, tmp_path):
    """Words of eight bytes, also of type 1; nas2cam_notall6_msc2017.op4 and rdbin.op4 of
    twmacro/pyyeti (pyyeti/tests/nas2cam_extseout and nastran_op4_data).
    """

    def record(*parts):
        body = b"".join(
            part if isinstance(part, bytes) else np.array(part, f"{order}i8").tobytes()
            for part in parts
        )
        size = np.array(len(body), f"{order}i4").tobytes()
        return size + body + size

    columns = [[4.0, -1.0], [-1.0, 6.0]]
    rows = -2 if form == "big" else 2
    data = record([2, rows, 6, 1], b"K       AA      ")
    for column, numbers in enumerate(columns, start=1):
        string = {"full": [], "sparse": [1 + 3 * 65536], "big": [3, 1]}[form]
        first = 1 if form == "full" else 0
        values = np.array(numbers, f"{order}f8").tobytes()
        data += record([column, first, len(string) + 2, *string], values)
    data += record([3, 1, 1], np.array(1.0, f"{order}f8").tobytes())
    (tmp_path / "part.op4").write_bytes(data)
    assert np.array_equal(read_matrices(tmp_path / "part.op4")["KAA"].toarray(), columns)
