"""Commands of proofs over the box: worst and certificate."""

from __future__ import annotations

from pathlib import Path

from hhr_dolfinx.command.loading import checked_target, model_of
from hhr_dolfinx.command.speaking import guarded, spoken
from hhr_dolfinx.command.words import KNOWN_OPTION, examples
from hhr_dolfinx.compat import extra

with extra("study", "the command hhr"):
    import click


@click.command(
    epilog=examples(
        "hhr worst model.npz peak", "hhr worst model.npz peak --limit 250 --certificate peak.npz"
    )
)
@click.argument("model", type=click.Path(path_type=Path))
@click.argument("output")
@click.option(
    "--within",
    type=float,
    default=0.01,
    show_default=True,
    help="largest difference of the value proven and one found, relative",
)
@click.option("--smallest", is_flag=True, help="ask for the smallest value")
@click.option("--limit", type=float, help="stop when it is known whether the output stays within")
@click.option(
    "--seconds", type=float, default=60.0, show_default=True, help="longest time of the search"
)
@click.option(
    "--certificate",
    type=click.Path(path_type=Path),
    help="write the proof, for hhr certificate, .npz",
)
@KNOWN_OPTION
@guarded
def worst(
    model: Path,
    output: str,
    within: float,
    smallest: bool,
    limit: float | None,
    seconds: float,
    certificate: Path | None,
    known: tuple[str, ...],
) -> None:
    """Prove the largest value of an OUTPUT of a MODEL over the box of its parameters."""
    from hhr_dolfinx.plugins.worst_case.search import worst as prove

    checked_target(certificate, (".npz",))
    loaded = model_of(model, known)
    console, _ = spoken()
    found = prove(loaded, output, within, smallest=smallest, limit=limit, seconds=seconds)
    console.print(str(found), markup=False, highlight=False, soft_wrap=True)
    if limit is not None:
        never = "proven" if found.never_beyond(limit) else "not proven"
        console.print(f"never beyond {limit:g}: {never}", markup=False, highlight=False)
    if certificate is not None:
        found.save(certificate)
        console.print(f"certificate: {certificate}", markup=False, highlight=False, soft_wrap=True)


@click.command(epilog=examples("hhr certificate peak.npz", "hhr certificate peak.npz --exact"))
@click.argument("certificate", type=click.Path(path_type=Path))
@click.option(
    "--exact", is_flag=True, help="in rational numbers, without round-off: up to 40 conditions"
)
@guarded
def certificate(certificate: Path, exact: bool) -> None:
    """Prove the value of a CERTIFICATE of hhr worst again, by other code."""
    from hhr_dolfinx.plugins.worst_case.check import check_certificate

    console, _ = spoken()
    console.print(str(check_certificate(certificate, exact=exact)), markup=False, highlight=False)
