"""Plug-ins: packages that add a capability to the core.

Each declares its additions and their places in one manifest.

A plug-in is an entry point of the group ``hhr_dolfinx.plugins`` that names a :class:`Plugin`. Those
of this package, in ``hhr_dolfinx/plugins/``, register as those of other packages do. Places are
written ``module:name`` and are loaded when they are used, so that a scene loads only the plug-ins
that it names.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import json
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple, Never

from hhr_dolfinx.errors import NotOfferedError, PluginWarning, SceneError
from hhr_dolfinx.warn import warn

GROUP = "hhr_dolfinx.plugins"
"""Group of entry points of plug-ins."""
OURS = Path(__file__).with_name("plug_ins.json")
"""Names that the plug-ins of this package add, for messages where one of them is deleted."""
SHARED_NAMES = (
    "public",
    "classes",
    "commands",
    "kinds",
    "methods",
    "trainings",
    "pair_laws",
    "recipes",
    "answers",
    "tools",
    "readers",
    "formats",
    "switches",
)
"""Mappings of manifests in which a name has one meaning for all plug-ins."""
NOTHING: Mapping[str, Never] = MappingProxyType({})


class Way(NamedTuple):
    """A reductor in a manifest: the place of its class, loaded for the scenes that want it, and for
    no other.

    The class without arguments has the usual settings, and ``wanted`` is a function of the full
    model. ``condense()`` takes the first one that ``condenses``: its models keep all contact
    conditions.
    """

    place: str
    wanted: Callable[..., bool]
    condenses: bool = False


class Bounds(NamedTuple):
    """Errors of the answers of hyper-reduced models, for the full models that ``wanted`` accepts.

    The first one applies.

    ``place`` is that of a function ``(full, basis, forces, *, cone, announce) -> Bounding``, see
    :class:`~hhr_dolfinx.models.bound.Bounding`, with the basis, (own, ell), and the training
    forces, (N_lambda, S); ``cone`` if these complete the forces outside the RID. It raises
    BoundError with the hypothesis that fails.
    """

    place: str
    wanted: Callable[..., bool]


class Stage(NamedTuple):
    """A stage of the hyper-reduction: the place of a function of a
    :class:`~hhr_dolfinx.reduction.build.Draft`.

    It follows the stage at the place ``after``, if ``wanted`` accepts the full model and the
    recipe.
    """

    place: str
    after: str = ""
    wanted: Callable[..., bool] = lambda full, recipe: True


@dataclass(frozen=True)
class Plugin:
    """Manifest of a plug-in."""

    name: str  #: name of the plug-in, unique
    needs: tuple[str, ...] = ()  #: names of the plug-ins that it requires
    optional: tuple[
        str, ...
    ] = ()  #: names of plug-ins that it imports only where a scene names them
    #: names that it adds to ``hhr_dolfinx``: of each module its names, separated by blanks
    public: Mapping[str, str] = field(default=NOTHING)
    #: what scenes may name: of each kind (``laws``, ``outputs``, ... of :mod:`hhr_dolfinx.by_name`)
    #: places by name, or of each module its names, as in ``public``
    parts: Mapping[str, Mapping[str, str]] = field(default=NOTHING)
    #: classes that model files may hold: of each module their names, separated by blanks
    classes: Mapping[str, str] = field(default=NOTHING)
    commands: Mapping[str, str] = field(
        default=NOTHING
    )  #: places of the commands of ``hhr``, by name
    #: kinds of models that a training can build: places of functions ``(training, **options) ->
    #: model`` by the name of the method of a :class:`~hhr_dolfinx.study.training.train.Training`,
    #: and of ``hhr train --model``
    kinds: Mapping[str, str] = field(default=NOTHING)
    #: further methods of a training, which build no model that a file can keep
    methods: Mapping[str, str] = field(default=NOTHING)
    #: ways to choose training points of ``hhr train``: places of objects with ``options``,
    #: decorators of click, and ``training(given)``, by the option that selects them
    trainings: Mapping[str, str] = field(default=NOTHING)
    materials: tuple[
        str, ...
    ] = ()  #: methods by which a law of a body is one of this plug-in, see :func:`reader_of`
    #: places of functions ``(value, what) -> PairLaw`` by the field of a pairing whose value they
    #: read, see :mod:`hhr_dolfinx.contact.law`
    pair_laws: Mapping[str, str] = field(default=NOTHING)
    #: places of functions ``(**changes) -> Recipe`` by their names as attributes of ``Recipe``
    recipes: Mapping[str, str] = field(default=NOTHING)
    #: ways to build a model by name, which ``hhr.reduce`` tries after those of the core
    reductors: Mapping[str, Way] = field(default=NOTHING)
    stages: tuple[Stage, ...] = ()  #: further stages of the hyper-reduction
    bounds: tuple[Bounds, ...] = ()  #: errors of the answers of hyper-reduced models
    #: names of the parts of :class:`~hhr_dolfinx.memory.Memory` that its laws keep in answers
    memory: tuple[str, ...] = ()
    #: what it adds to answers: places of functions of an answer, by the names of methods
    answers: Mapping[str, str] = field(default=NOTHING)
    #: places of objects that do for its laws what the core leaves to them, by words: each part of
    #: the core that needs one documents its word and protocol, and refuses a law without it, see
    #: :func:`facet`
    facets: Mapping[str, str] = field(default=NOTHING)
    #: places of functions that the core calls by a word, of all plug-ins one for each word, see
    #: :func:`tool`
    tools: Mapping[str, str] = field(default=NOTHING)
    #: places of readers of mesh files, ``(path) -> RawMesh`` of
    #: :mod:`hhr_dolfinx.geometries.raw_mesh`, by the ending
    readers: Mapping[str, str] = field(default=NOTHING)
    #: places of functions ``(path) -> model`` that read model files, by the format in their header
    formats: Mapping[str, str] = field(default=NOTHING)
    #: functions ``(draft, neutral) -> draft`` that add one capability to a small scene, of each
    #: module their names, as in ``public``; the plug-in ``conformance`` has the drafts
    switches: Mapping[str, str] = field(default=NOTHING)
    #: places of functions ``(full, folder) -> None`` that write further files next to a model;
    #: collective over the ranks of the full model
    companions: tuple[str, ...] = ()


@functools.cache
def installed() -> Mapping[str, Plugin]:
    """Plug-ins by name, those of this package first.

    A PluginWarning names each one that is left out, and the reason; errors of a plug-in are not
    raised.

    Left out are plug-ins that cannot be loaded, lack a plug-in that they need, or register what
    another one has.
    """
    plugins: dict[str, Plugin] = {}
    owners: dict[tuple[str, str], tuple[str, str]] = {}
    for point in sorted(
        importlib.metadata.entry_points(group=GROUP), key=lambda one: not _is_ours(one.value)
    ):
        try:
            plugin = point.load()
            if not isinstance(plugin, Plugin):
                raise TypeError(
                    f"{point.value} is a {type(plugin).__name__} and no hhr_dolfinx.registry.Plugin"
                )
            registered = _registered(plugin)
        except (Exception, SystemExit) as error:  # third-party code may raise anything
            _leave_out(
                point.name, f"{point.value} cannot be loaded: {type(error).__name__}: {error}"
            )
            continue
        if plugin.name in plugins:
            if plugins[plugin.name] is not plugin:
                _leave_out(
                    plugin.name,
                    f"{point.value} has the name of another plug-in: give it a different one",
                )
            continue
        if conflicting := [
            key for key, path in registered.items() if owners.get(key, (path, ""))[0] != path
        ]:
            kind, name = conflicting[0]
            path, owner = owners[conflicting[0]]
            _leave_out(
                plugin.name,
                f"it registers {name!r} among {kind}, which is {path} of the plug-in '{owner}'",
            )
            continue
        plugins[plugin.name] = plugin
        owners |= {key: (path, plugin.name) for key, path in registered.items()}
    while lacking := [
        name for name, plugin in plugins.items() if not plugins.keys() >= set(plugin.needs)
    ]:
        for name in lacking:
            missing = set(plugins.pop(name).needs) - plugins.keys()
            _leave_out(name, f"it needs {', '.join(sorted(missing))}")
    return MappingProxyType(dict(sorted(plugins.items())))


def _is_ours(place: str) -> bool:
    return place.startswith(f"{GROUP}.")


def _registered(plugin: Plugin) -> dict[tuple[str, str], str]:
    """Places of all that a plug-in registers by a name, which no other plug-in may have, by kind
    and name.
    """
    named = {kind: getattr(plugin, kind) for kind in SHARED_NAMES} | dict(plugin.parts)
    return {
        (kind, name): path for kind, mapping in named.items() for name, path in places_in(mapping)
    }


def owned(plugin: Plugin) -> Iterator[tuple[str, str]]:
    """Kinds and names of all that a plug-in adds, as :func:`remedy` finds them."""
    yield from _registered(plugin)
    yield from (("materials", method) for method in plugin.materials)


@functools.cache
def _ours() -> dict[str, dict[str, str]]:
    """Names of the plug-ins of this package by kind and name; scripts/stubs.py writes the file."""
    names_by_kind: dict[str, dict[str, str]] = json.loads(OURS.read_text(encoding="utf-8"))
    return names_by_kind


def remedy(what: str, name: str) -> str:
    """End of a message that names the plug-in of this package to install, or "".

    Args:
        what: kind of the name.
        name: the name.

    Returns:
        ``: it belongs to the plug-in ...``; "" if no plug-in of this package has it, or it is
        installed.
    """
    plugin = _ours().get(what, {}).get(name)
    if plugin is None or plugin in installed():
        return ""
    return f": it belongs to the plug-in '{plugin}', which is not installed"


def wants(item: Way | Bounds | Stage, *given: Any) -> bool:
    """True if a reductor, bound or stage wants a full model.

    One whose ``wanted`` fails is left out with a warning.
    """
    try:
        return bool(item.wanted(*given))
    except Exception as error:  # third-party code may raise anything
        warn(
            f"{item.place} is left out: its 'wanted' raised {type(error).__name__}: {error}",
            PluginWarning,
        )
        return False


def loadable(what: str) -> dict[str, Any]:
    """Objects by name in one mapping of all manifests.

    A PluginWarning names each one that cannot be loaded.
    """
    objects = {}
    for name, path in named(what).items():
        try:
            objects[name] = load(path)
        except (Exception, SystemExit) as error:  # third-party code may raise anything
            if _is_ours(path):
                raise
            warn(
                f"{name!r} of {path} is left out: {type(error).__name__}: {error}",
                PluginWarning,
            )
    return objects


def _leave_out(name: str, why: str) -> None:
    warn(f"the plug-in '{name}' is left out: {why}", PluginWarning)


def load(place: str) -> Any:
    """Object at a place, ``module:name``."""
    module, _, name = place.partition(":")
    return getattr(importlib.import_module(module), name)


def named(what: str) -> dict[str, str]:
    """Places by name in one mapping of all manifests, such as ``classes``.

    Raises:
        SceneError: for a name of two plug-ins.
    """
    paths: dict[str, str] = {}
    for plugin in installed().values():
        for name, path in places_in(getattr(plugin, what)):
            if paths.setdefault(name, path) != path:
                raise SceneError(
                    f"two plug-ins register {name!r} among their {what}: {paths[name]} and {path}"
                )
    return paths


def places_in(mapping: Mapping[str, str]) -> Iterator[tuple[str, str]]:
    """Names with their places in a mapping of names to places, or of modules to names separated by
    blanks.
    """
    for key, value in mapping.items():
        if ":" in value:
            yield key, value
        else:
            yield from ((name, f"{key}:{name}") for name in value.split())


def parts(kind: str) -> dict[str, tuple[str, str]]:
    """Parts of scenes of one kind: place and plug-in by name."""
    return {
        name: (path, plugin.name)
        for plugin in installed().values()
        for name, path in places_in(plugin.parts.get(kind, {}))
    }


@functools.cache
def memories(*, of_bodies: bool = False) -> frozenset[str]:
    """Names of the parts of memories that laws of plug-ins keep in answers: of all laws, or of
    those of bodies.
    """
    plugins = [plugin for plugin in installed().values() if plugin.materials or not of_bodies]
    return frozenset(name for plugin in plugins for name in plugin.memory)


@functools.cache
def asked_of_answers() -> Mapping[str, str]:
    """Places of functions of an answer by the names of the methods that plug-ins add to it."""
    return named("answers")


loaded = functools.cache(load)
"""Objects at places, quicker: a history asks each of its answers."""


def reader_of(law: object, what: str) -> str:
    """Name of the plug-in that reads the law of a body, by a method of the law.

    Args:
        law: the law.
        what: description of the body for the message.

    Raises:
        SceneError: if no plug-in reads it.
    """
    methods = {
        method: plugin.name for plugin in installed().values() for method in plugin.materials
    }
    for method, name in methods.items():
        if not isinstance(law, type) and callable(getattr(law, method, None)):
            return name
    if not methods:
        theirs = [
            advice for name in _ours().get("materials", {}) if (advice := remedy("materials", name))
        ]
        raise SceneError(
            f"{what}: no installed plug-in reads the law {law!r}{theirs[0] if theirs else ''}"
        )
    raise SceneError(
        f"{what}: the law {law!r} must be an object with a method {' or '.join(methods)}"
    )


@functools.cache
def facet(plugin: str, word: str, what: str) -> Any:
    """Facet of a plug-in, which one place of the core needs for its laws.

    Args:
        plugin: name of the plug-in.
        word: name of the facet.
        what: description of the request for the message.

    Raises:
        NotOfferedError: if the plug-in is missing, or has no such facet: the law would be ignored.
    """
    plugins = installed()
    if plugin not in plugins:
        raise NotOfferedError(f"{what} needs the plug-in '{plugin}', which is not installed")
    if word not in plugins[plugin].facets:
        raise NotOfferedError(
            f"{what} is not built in for what the plug-in '{plugin}' adds: it has no facet '{word}'"
        )
    return load(plugins[plugin].facets[word])


def tool(word: str, what: str) -> Any:
    """Function that a plug-in offers by a word, such as ``drawing`` or ``fields``.

    ``drawing(value, path, full=None)`` is a figure of matplotlib, saved if a path is given, of a
    scene, or of an answer on the mesh of a full model; its keyword ``scale`` is the factor of
    displacements. ``curves(history, path, y, x)`` is a figure of the outputs ``y`` of a history
    over ``x``. ``fields(path, full, answer)`` writes the fields of an answer and returns the files.
    ``forces_outside(problem, law, conditions, forces)`` completes forces outside the RID, an
    :class:`~hhr_dolfinx.models.answer.InterfaceCompletion`, from training forces, (N_lambda, S).
    ``histories(paths)`` are :class:`~hhr_dolfinx.snapshots.records.Queries` along paths.
    ``queries(scene, training, held_out)`` are checked paths, or a training that chooses them, and
    paths held out. ``reduction(full)`` is the kind of answers of a full model with laws of
    contacts, an :class:`~hhr_dolfinx.reduction.kinds.OfPoints`. ``mesh_beside(path, model)`` is the
    :class:`~hhr_dolfinx.models.answer.Meshed` of a model file, read when it is used; ``model()`` is
    then the model.

    Args:
        word: name of the tool.
        what: description of the request for the message.

    Raises:
        NotOfferedError: if no installed plug-in has it.
    """
    if (function := offered(word)) is None:
        raise NotOfferedError(
            f"{what} needs a plug-in with the tool '{word}', and none is "
            f"installed{remedy('tools', word)}"
        )
    return function


def offered(word: str) -> Any | None:
    """Object of a tool that the core can do without, such as quicker factors, ``substructures``.

    None without one.
    """
    path = named("tools").get(word)
    return None if path is None else load(path)


def write_companions(full: object, folder: Path) -> None:
    """Write the files of plug-ins next to a model in a folder.

    Collective over the ranks of the full model.

    Args:
        full: the full model.
        folder: folder of the model.
    """
    for path in [path for plugin in installed().values() for path in plugin.companions]:
        load(path)(full, folder)
