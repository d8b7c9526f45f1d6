"""Memory of an answer: the internal variables of laws, by name, which the next step starts from."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from hhr_dolfinx.plain import Remade, rebuilt


class Memory(Mapping[str, Any]):
    """Internal variables of an answer by the names that laws give them.

    Nobody writes into their arrays.
    """

    __slots__ = ("_parts",)

    def __init__(self, **parts: Any):
        self._parts = parts

    def __getitem__(self, name: str) -> Any:
        return self._parts[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._parts)

    def __len__(self) -> int:
        return len(self._parts)

    def __or__(self, more: Mapping[str, Any]) -> Memory:
        """These variables and more; for a name that both have, ``more`` has precedence."""
        return Memory(**{**self._parts, **more})

    def counted(self) -> dict[str, int]:
        """Numbers that a line on the answer shows, by name.

        They are those of the variables that have a method ``counted``.
        """
        counts = [
            variable.counted() for variable in self._parts.values() if hasattr(variable, "counted")
        ]
        return {name: number for count in counts for name, number in count.items()}

    def __reduce__(self) -> Remade[Memory]:
        return rebuilt, (Memory, self._parts)

    def __repr__(self) -> str:
        return f"Memory of {', '.join(self._parts) or 'nothing'}"


NO_MEMORY = Memory()
"""Memory of an answer that does not depend on a path."""
