"""Choice between full models on each rank, which solve in parallel, and one distributed over
ranks.
"""

from __future__ import annotations

from pathlib import Path

from mpi4py import MPI

from hhr_dolfinx.full_order.discretisation import discretised
from hhr_dolfinx.group import ProcessGroup
from hhr_dolfinx.plugins.ranks.expected import expected_in_space
from hhr_dolfinx.scene import Scene

FREE_MEMORY_SHARE = 0.8
"""Part of the free memory that full models may take: answers and models need some too."""


def no_room_side_by_side(scene: Scene, group: ProcessGroup) -> str:
    """Reason why full models, one for each rank, exceed the memory of a machine; empty if they fit.

    Collective.

    One rank of each machine generates the mesh, from which the memory in space is estimated.
    Problems with shape parameters are never distributed, and models in the plane are small.

    Args:
        scene: the scene.
        group: the ranks.
    """
    if scene.hypothesis != "solid" or scene.shapes:
        return ""
    machine = group.comm.Split_type(MPI.COMM_TYPE_SHARED)
    reason = ""
    with group.each(f"looking at the size of scene '{scene.name}'"):
        room = free_gigabytes()
        if machine.rank == 0 and room is not None:
            rows, _ = discretised(scene, MPI.COMM_SELF).contact_rows()
            needed = expected_in_space(rows.matrix).gigabytes
            if machine.size * needed > FREE_MEMORY_SHARE * room:
                reason = (
                    f"{machine.size} full models of about {needed:.2g} GB have no room in "
                    f"{room:.2g} GB of memory"
                )
    machine.Free()
    return next((text for text in group.gathered(reason) if text), "")


def free_gigabytes(meminfo: Path = Path("/proc/meminfo")) -> float | None:
    """Free memory of this machine; None if it is unknown, as on systems other than Linux."""
    try:
        lines = dict(line.split(":", 1) for line in meminfo.read_text().splitlines())
        return 1.024e-6 * float(lines["MemAvailable"].split()[0])
    except (OSError, KeyError, ValueError, IndexError):
        return None
