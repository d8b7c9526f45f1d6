"""Small stand-ins of other programs, which check what a recipe of docs/coupling.md gives them.

Each function returns modules by name, for ``sys.modules``. Signatures are those of the libraries.
"""

import importlib.util
from types import ModuleType, SimpleNamespace

import numpy as np


def module(name, **items):
    made = ModuleType(name)
    vars(made).update(items)
    return made


class PythonFunction:
    """``openturns.PythonFunction`` of a function of samples: floats in lists, (n, P) -> (n, K)."""

    def __init__(self, inputs, outputs, *, func_sample, gradient):
        self.sizes = inputs, outputs
        self.func_sample, self.slopes = func_sample, gradient
        self.names = {}

    def setInputDescription(self, names):
        assert len(names) == self.sizes[0] and all(isinstance(name, str) for name in names)
        self.names["in"] = list(names)

    def setOutputDescription(self, names):
        assert len(names) == self.sizes[1] and all(isinstance(name, str) for name in names)
        self.names["out"] = list(names)

    def getInputDescription(self):
        return self.names["in"]

    def getOutputDescription(self):
        return self.names["out"]

    def __call__(self, points):
        points = [list(map(float, point)) for point in np.atleast_2d(points)]
        found = np.array([list(map(float, row)) for row in self.func_sample(points)])
        assert found.shape == (len(points), self.sizes[1])
        return found if len(points) > 1 else found[0]

    def gradient(self, point):
        found = np.array([list(map(float, row)) for row in self.slopes(list(map(float, point)))])
        assert found.shape == self.sizes  # a row for each input
        return found


def openturns():
    return {"openturns": module("openturns", PythonFunction=PythonFunction, Sample=np.array)}


class Space:
    """``NumpyVectorSpace``: vectors are columns."""

    def __init__(self, dim):
        self.dim = int(dim)

    def from_numpy(self, data):
        assert data.shape == (self.dim, 1) and data.dtype == float
        return SimpleNamespace(to_numpy=lambda: data)


class Slopes:
    """``OutputDMuResult``: a matrix, (K, dim), for each parameter and index."""

    def __init__(self, found):
        self.found = found

    def to_numpy(self):
        columns = [self.found[key] for key in sorted(self.found)]
        assert all(column.ndim == 2 and column.shape[1] == 1 for column in columns)
        return np.stack(columns, axis=2)  # (K, 1, P)


class Model:
    """``pymor.models.interface.Model``: quantities left after ``_compute`` are unknown to it."""

    def __init__(self, name=None):
        self.name = name

    def __setattr__(self, name, value):
        if name == "parameters_own":
            value = dict(sorted(value.items()))  # as pyMOR does
        super().__setattr__(name, value)

    @property
    def parameters(self):
        assert set(self.parameters_own.values()) == {1}
        given = list(self.parameters_own)

        def parse(values):
            assert sorted(values) == given
            return {name: np.array([float(values[name])]) for name in given}

        return SimpleNamespace(dim=len(given), parse=parse)

    def _compute(self, quantities, data, mu):
        if quantities:
            raise NotImplementedError(quantities)

    def compute(self, mu, *quantities):
        data = {}
        self._compute(set(quantities), data, mu)
        assert data.keys() >= set(quantities)
        shape = self.dim_output, 1
        assert all(data[name].shape == shape for name in quantities if name.startswith("output_e"))
        return [data[name] for name in quantities]

    def solve(self, mu, return_error_estimate=False):
        names = ["solution"] + ["solution_error_estimate"] * return_error_estimate
        found = self.compute(mu, *names)
        return found if return_error_estimate else found[0]

    def output(self, mu, return_error_estimate=False):
        names = ["output"] + ["output_error_estimate"] * return_error_estimate
        found = self.compute(mu, *names)
        assert found[0].shape == (self.dim_output, 1)
        return found if return_error_estimate else found[0]

    def output_d_mu(self, mu):
        return self.compute(mu, "output_d_mu")[0]


def pymor():
    names = "pymor", "pymor.models", "pymor.vectorarrays"
    return {name: module(name) for name in names} | {
        "pymor.models.interface": module("interface", Model=Model, OutputDMuResult=Slopes),
        "pymor.vectorarrays.numpy": module("numpy", NumpyVectorSpace=Space),
    }


class Shaped:
    """``Array[shape, type]`` of an annotation, which a schema checks."""

    def __class_getitem__(cls, item):
        return item[0]


class Differentiable:
    """``Differentiable[...]`` of an array."""

    def __class_getitem__(cls, item):
        return item


class ShapeDType(SimpleNamespace):
    """Shape and type of an array, without its values."""


class BaseModel:
    """``pydantic.BaseModel`` whose fields are arrays: checks shape and type, then validates."""

    def __init__(self, **fields):
        assert fields.keys() == self.__annotations__.keys()
        for name, value in fields.items():
            if not isinstance(value, ShapeDType):
                value = np.asarray(value)
                assert value.dtype == float and value.shape == self.__annotations__[name]
            for item in vars(type(self)).values():
                if getattr(item, "field", None) == name:
                    value = item.__get__(None, type(self))(value)
            setattr(self, name, value)


def field_validator(name):
    def marked(method):
        assert isinstance(method, classmethod)
        method.field = name
        return method

    return marked


class Tesseract:
    """``tesseract_core.Tesseract`` of a file, which calls endpoints by their fields."""

    @classmethod
    def from_tesseract_api(cls, path):
        spec = importlib.util.spec_from_file_location("tesseract_api", path)
        made = cls()
        made.api = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(made.api)
        return made

    def __enter__(self):
        return self

    def __exit__(self, *error):
        pass

    def apply(self, inputs):
        return vars(self.api.apply(self.api.InputSchema(**inputs)))

    def jacobian(self, inputs, jac_inputs, jac_outputs):
        return self.api.jacobian(self.api.InputSchema(**inputs), set(jac_inputs), set(jac_outputs))

    def jacobian_vector_product(self, inputs, jvp_inputs, jvp_outputs, tangent_vector):
        given = self.api.InputSchema(**inputs), set(jvp_inputs), set(jvp_outputs)
        return self.api.jacobian_vector_product(*given, tangent_vector=tangent_vector)

    def vector_jacobian_product(self, inputs, vjp_inputs, vjp_outputs, cotangent_vector):
        given = self.api.InputSchema(**inputs), set(vjp_inputs), set(vjp_outputs)
        return self.api.vector_jacobian_product(*given, cotangent_vector=cotangent_vector)

    def abstract_eval(self, inputs):
        shapes = {name: ShapeDType(**value) for name, value in inputs.items()}
        found = self.api.abstract_eval(self.api.InputSchema(**shapes))
        assert all(value.dtype == "float64" for value in found.values())
        return {name: vars(value) for name, value in found.items()}


def tesseract():
    types = {"Array": Shaped, "Differentiable": Differentiable, "Float64": float}
    runtime = module("runtime", ShapeDType=ShapeDType, **types)
    return {
        "pydantic": module("pydantic", BaseModel=BaseModel, field_validator=field_validator),
        "tesseract_core": module("tesseract_core", Tesseract=Tesseract),
        "tesseract_core.runtime": runtime,
    }
