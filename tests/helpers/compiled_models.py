"""C headers and units of models, compiled and called."""

import ctypes
import platform
import shutil
import subprocess
import zipfile
from xml.etree import ElementTree

import numpy as np
import pytest

from hhr_dolfinx.plugins.exporters import c_header

CC = shutil.which("cc")
compiled = pytest.mark.skipif(CC is None, reason="there is no C compiler")
WORDS = ["-std=c99", "-Wall", "-Wextra", "-pedantic", "-Werror", "-O2", "-shared", "-fPIC"]
DONE, OUTSIDE, NO_ANSWER, CHANGED = 0, 1, 2, 3


def built(folder, model, program):
    """The library of a program that includes the header of a model, compiled without a warning."""
    c_header.write_c_header(folder / "press.h", model)
    (folder / "press.c").write_text(program)
    done = subprocess.run(
        [CC, *WORDS, "-o", "press.so", "press.c", "-lm"], cwd=folder, capture_output=True, text=True
    )
    assert done.returncode == 0, done.stderr
    return ctypes.CDLL(str(folder / "press.so"))


def at(*arrays):
    return [ctypes.c_void_p(array.ctypes.data) for array in arrays]


class Instance:
    """An instance of a unit, called by its functions as an importer does."""

    def __init__(self, folder, unit, log=None):
        with zipfile.ZipFile(unit) as archive:
            archive.extractall(folder)
        (binary,) = (folder / "binaries").glob("*/model.*")
        assert binary.parent.name == f"{platform.machine()}-{platform.system().lower()}"
        described = ElementTree.parse(folder / "modelDescription.xml").getroot()
        self.variables = list(described.find("ModelVariables"))
        self.made, pointer = ctypes.CDLL(str(binary)), ctypes.c_void_p
        self.made.fmi3InstantiateCoSimulation.restype = pointer
        self.made.fmi3DoStep.argtypes = [
            pointer,
            ctypes.c_double,
            ctypes.c_double,
            ctypes.c_bool,
            *[pointer] * 4,
        ]
        rest = [None, False, False, False, False, None, ctypes.c_size_t(0), None, log, None]
        assert not self.made.fmi3InstantiateCoSimulation(b"one", b"another token", *rest)
        token = described.get("instantiationToken").encode()
        self.at = pointer(self.made.fmi3InstantiateCoSimulation(b"one", token, *rest))
        kinds = [item.get("causality") for item in self.variables]
        self.outputs = kinds.count("output")
        self.inputs = len(kinds) - 1 - self.outputs

    def put(self, point):
        places, count = (
            (ctypes.c_uint32 * self.inputs)(*range(1, self.inputs + 1)),
            ctypes.c_size_t(self.inputs),
        )
        return self.made.fmi3SetFloat64(
            self.at, places, count, (ctypes.c_double * self.inputs)(*point), count
        )

    def read(self, status=0):
        first, count, found = (
            self.inputs + 1,
            ctypes.c_size_t(self.outputs),
            (ctypes.c_double * self.outputs)(),
        )
        places = (ctypes.c_uint32 * self.outputs)(*range(first, first + self.outputs))
        assert self.made.fmi3GetFloat64(self.at, places, count, found, count) == status
        return np.array(found)

    def begin(self):
        return self.made.fmi3ExitInitializationMode(self.at)

    def step(self, number, size=1.0):
        flags, last = (ctypes.c_bool * 3)(), ctypes.c_double()
        ends = [ctypes.byref(flags, k) for k in range(3)]
        given = self.at, float(number), size, False, *ends, ctypes.byref(last)
        status = self.made.fmi3DoStep(*given)
        assert status or last.value == number + 1
        return status


STEPPED = """
#include "press.h"
int ask(int count, const double *points, double *forces, double *outputs, double *reached,
        int *statuses) {
    press_path *path = press_path_new();
    int status = press_rest(path, points);
    for (int k = 1; k < count && !status; k++) {
        double *own = forces + (k - 1) * PRESS_CONDITIONS;
        double *told = outputs + (k - 1) * PRESS_OUTPUTS;
        status = press_go(path, points + k * PRESS_PARAMETERS, own, told);
#ifdef PRESS_POINTS
        (void)statuses;
        memcpy(reached + (k - 1) * PRESS_POINTS, path->state->memory + PRESS_SIZE,
               PRESS_POINTS * sizeof(double));
#else
        for (int i = 0, c = PRESS_CONTACTS; i < c && !status; i++) {
            double *slip = reached + ((k - 1) * c + i) * 3;
            const press_slip *known = &path->state->slip;
            slip[0] = known->slipped[i], slip[1] = known->work[i], slip[2] = known->wear[i];
            statuses[(k - 1) * c + i] = known->statuses[i];
        }
#endif
    }
    press_path_free(path);
    return status;
}
int begin(const double *point, double *forces, double *outputs) {
    press_path *path = press_path_new();
    const int status = press_begin(path, point, forces, outputs);
    press_path_free(path);
    return status;
}
"""
