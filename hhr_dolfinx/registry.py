"""Plug-ins: packages that add a capability to the core. Each declares its additions and their places in one manifest.

A plug-in is an entry point of the group ``hhr_dolfinx.plugins`` that names a :class:`Plugin`. Those of this package, in
``hhr_dolfinx/plugins/``, register as those of other packages do. Places are written ``module:name`` and are
loaded when they are used, so that a scene loads only the plug-ins that it names.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple, Protocol

from hhr_dolfinx.errors import NotOfferedError, PluginWarning, SceneError
from hhr_dolfinx.warn import warn

if TYPE_CHECKING:
    from mpi4py.MPI import Comm

GROUP = "hhr_dolfinx.plugins"
"""Group of entry points of plug-ins."""
NOTHING: Mapping[str, Any] = MappingProxyType({})


class Way(NamedTuple):
    """A reductor in a manifest. It is loaded for the scenes that want it, and for no other.

    Attributes:
        place: of its class; a value without arguments has the usual settings.
        wanted: function of the full model.
        condenses: whether its models keep all contact conditions; ``condense()`` takes the first such one.
    """

    place: str
    wanted: Callable[..., bool]
    condenses: bool = False


class Bounds(NamedTuple):
    """Bounds of the errors of hyper-reduced models, for some scenes; the core has those of constant stiffness.

    Attributes:
        place: of a function ``(full, basis, forces, *, announce) -> Bound``, with the basis, (own, ell), and the
            training forces, (N_lambda, S); it raises BoundError with the hypothesis that fails.
        wanted: function of the full model.
    """

    place: str
    wanted: Callable[..., bool]


class Stage(NamedTuple):
    """A stage of the hyper-reduction, a function of a :class:`~hhr_dolfinx.reduction.build.Draft`.

    Attributes:
        place: of the function.
        after: place of the stage that it follows.
        wanted: function of the full model and the recipe.
    """

    place: str
    after: str = ""
    wanted: Callable[..., bool] = lambda full, recipe: True


@dataclass(frozen=True)
class Plugin:
    """Manifest of a plug-in.

    Attributes:
        name: name of the plug-in, unique.
        needs: names of the plug-ins that it requires.
        public: names that it adds to ``hhr_dolfinx``: of each module its names, separated by blanks.
        parts: what scenes may name: of each kind (``laws``, ``outputs``, ... of :mod:`hhr_dolfinx.by_name`) places by
            name.
        classes: classes that model files may hold: of each module their names, separated by blanks.
        commands: places of the commands of ``hhr``, by name.
        kinds: kinds of models that a training can build: places of functions ``(training, **options) -> model`` by the
            name of the method of a :class:`~hhr_dolfinx.study.training.train.Training`, and of ``hhr train --model``.
        methods: further methods of a training, which build no model that a file can keep.
        trainings: ways to choose training points of ``hhr train``: places of objects with
            ``options``, decorators of click, and ``training(given)``, by the option that selects them.
        materials: methods by which a law of a body is one of this plug-in, see :func:`reader_of`.
        pair_laws: places of functions ``(value, what) -> PairLaw`` by the field of a pairing whose value they read, see
            :mod:`hhr_dolfinx.contact.law`.
        recipes: places of functions ``(**changes) -> Recipe`` by their names as attributes of ``Recipe``.
        reductors: ways to build a model by name, which ``hhr.reduce`` tries after those of the core.
        stages: further stages of the hyper-reduction.
        bounds: bounds of the errors of its models, which replace those of the core.
        memory: names of the parts of :class:`~hhr_dolfinx.memory.Memory` that its laws keep in answers.
        answers: what it adds to answers: places of functions of an answer, by the names of methods.
        facets: places of objects that do for its laws what the core leaves to them, by words: each part of the core
            that needs one documents its word and protocol, and refuses a law without it, see :func:`facet`.
        tools: places of functions that the core calls by a word, of all plug-ins one for each word, see :func:`tool`.
        companions: places of functions ``(full, folder) -> None`` that write further files next to a model;
            collective over the ranks of the full model.
    """

    name: str
    needs: tuple[str, ...] = ()
    public: Mapping[str, str] = field(default=NOTHING)
    parts: Mapping[str, Mapping[str, str]] = field(default=NOTHING)
    classes: Mapping[str, str] = field(default=NOTHING)
    commands: Mapping[str, str] = field(default=NOTHING)
    kinds: Mapping[str, str] = field(default=NOTHING)
    methods: Mapping[str, str] = field(default=NOTHING)
    trainings: Mapping[str, str] = field(default=NOTHING)
    materials: tuple[str, ...] = ()
    pair_laws: Mapping[str, str] = field(default=NOTHING)
    recipes: Mapping[str, str] = field(default=NOTHING)
    reductors: Mapping[str, Way] = field(default=NOTHING)
    stages: tuple[Stage, ...] = ()
    bounds: tuple[Bounds, ...] = ()
    memory: tuple[str, ...] = ()
    answers: Mapping[str, str] = field(default=NOTHING)
    facets: Mapping[str, str] = field(default=NOTHING)
    tools: Mapping[str, str] = field(default=NOTHING)
    companions: tuple[str, ...] = ()


@functools.cache
def installed() -> Mapping[str, Plugin]:
    """Plug-ins by name; all that they need are installed.

    Warns:
        PluginWarning: for each plug-in that is left out: it cannot be loaded, is not a manifest, has the name of
            another one, or needs a missing one.
    """
    found: dict[str, Plugin] = {}
    for point in importlib.metadata.entry_points(group=GROUP):
        try:
            plugin = point.load()
            if not isinstance(plugin, Plugin):
                raise TypeError(f"{point.value} is a {type(plugin).__name__} and no hhr_dolfinx.registry.Plugin")
        except (Exception, SystemExit) as error:  # third-party code may raise anything
            _leave_out(point.name, f"{point.value} cannot be loaded: {type(error).__name__}: {error}")
            continue
        if plugin.name in found and found[plugin.name] is not plugin:
            _leave_out(plugin.name, f"{point.value} has the name of another plug-in")
            continue
        found[plugin.name] = plugin
    while lacking := [name for name, plugin in found.items() if not found.keys() >= set(plugin.needs)]:
        for name in lacking:
            missing = set(found.pop(name).needs) - found.keys()
            _leave_out(name, f"it needs {', '.join(sorted(missing))}")
    return MappingProxyType(dict(sorted(found.items())))


def _leave_out(name: str, why: str) -> None:
    warn(f"the plug-in '{name}' is left out: {why}", PluginWarning, stacklevel=3)


def load(place: str) -> Any:
    """Object at a place, ``module:name``."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


def named(what: str) -> dict[str, str]:
    """Places by name in one mapping of the manifests of all plug-ins: ``public``, ``classes``, ``commands``, ...

    Raises:
        SceneError: for a name that two plug-ins have.
    """
    places: dict[str, str] = {}
    for plugin in installed().values():
        for name, place in places_in(getattr(plugin, what)):
            if places.setdefault(name, place) != place:
                raise SceneError(f"two plug-ins register {name!r} among their {what}: {places[name]} and {place}")
    return places


def places_in(mapping: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Names with their places in a mapping of names to places, or of modules to names separated by blanks."""
    for key, value in mapping.items():
        if ":" in value:
            yield key, value
        else:
            yield from ((name, f"{key}:{name}") for name in value.split())


def parts(kind: str) -> dict[str, tuple[str, str]]:
    """Parts of scenes of one kind: place and plug-in by name."""
    return {
        name: (place, plugin.name)
        for plugin in installed().values()
        for name, place in plugin.parts.get(kind, {}).items()
    }


@functools.cache
def memories(*, of_bodies: bool = False) -> frozenset[str]:
    """Names of the parts of memories that laws of plug-ins keep in answers: of all laws, or of those of bodies."""
    plugins = [plugin for plugin in installed().values() if plugin.materials or not of_bodies]
    return frozenset(name for plugin in plugins for name in plugin.memory)


@functools.cache
def asked_of_answers() -> Mapping[str, Any]:
    """Functions of an answer by the names of the methods that plug-ins add to it; modules are imported at first use."""
    return {name: functools.partial(_called, place) for name, place in named("answers").items()}


def _called(place: str, answer: object) -> Any:
    return _loaded(place)(answer)


_loaded = functools.cache(load)
"""Objects at places, quicker: a history asks each of its answers."""


def reader_of(law: object, what: str) -> str:
    """Name of the plug-in that reads a law of a body, by a method of the law.

    Args:
        law: the law.
        what: what has it, for the message.

    Raises:
        SceneError: if no installed plug-in reads it: it would be ignored.
    """
    methods = {method: plugin.name for plugin in installed().values() for method in plugin.materials}
    for method, name in methods.items():
        if not isinstance(law, type) and callable(getattr(law, method, None)):
            return name
    if not methods:
        raise SceneError(f"{what}: no installed plug-in reads the law {law!r}")
    raise SceneError(f"{what}: the law {law!r} must be an object with a method {' or '.join(methods)}")


@functools.cache
def facet(plugin: str, word: str, what: str) -> Any:
    """Facet of a plug-in: its part of one place of the core, for its laws.

    Args:
        plugin: name of the plug-in.
        word: name of the facet.
        what: what needs it, for the message.

    Raises:
        NotOfferedError: if the plug-in is missing, or has no such facet: the law would be ignored.
    """
    known = installed()
    if plugin not in known:
        raise NotOfferedError(f"{what} needs the plug-in '{plugin}', which is not installed")
    if word not in known[plugin].facets:
        raise NotOfferedError(f"{what} is not built in for what the plug-in '{plugin}' adds: it has no facet '{word}'")
    return load(known[plugin].facets[word])


class Drawing(Protocol):
    """The tool ``drawing``: figures of scenes and of answers."""

    def __call__(self, value: object, path: object, full: object = None) -> Any:
        """Figure of matplotlib, saved if a path is given, of a scene, or of an answer on the mesh of a full model."""


class FieldsFile(Protocol):
    """The tool ``fields``: files of fields for viewers."""

    def __call__(self, path: object, full: object, answer: object) -> list[Path]:
        """Write the fields of an answer on the mesh of a full model, and return the files."""


def tool(word: str, what: str) -> Any:
    """Function that a plug-in offers by a word: ``drawing``, a :class:`Drawing`; ``fields``, a :class:`FieldsFile`;
    ``mesh_error``, a function of a full model and an answer that estimates the error of its mesh; ``shapes``, which
    makes the :class:`~hhr_dolfinx.contact.problem.Reshaping` of a discretisation whose scene has shapes.

    Args:
        word: name of the tool.
        what: what needs it, for the message.

    Raises:
        NotOfferedError: if no installed plug-in has it.
    """
    places = named("tools")
    if word not in places:
        raise NotOfferedError(f"{what} needs a plug-in with the tool '{word}', and none is installed")
    return load(places[word])


def listed(what: str) -> list[Any]:
    """Objects at the places in one list of the manifests of all plug-ins, such as ``companions``."""
    return [load(place) for plugin in installed().values() for place in getattr(plugin, what)]


class ModelOnRanks(Protocol):
    """A full model, whose ranks write together. The core does not say what else a companion reads of it."""

    @property
    def comm(self) -> Comm:
        """Its ranks."""


def write_companions(full: ModelOnRanks, folder: Path) -> None:
    """Write the files of plug-ins next to a model in a folder. Collective over the ranks of the full model."""
    for write in listed("companions"):
        write(full, folder)
