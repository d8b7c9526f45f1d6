"""A command, and what lies beside a model."""

import click


@click.command()
def slabs():
    """Say how wide a slab is."""
    from contact_toys.parts import WIDTH

    click.echo(f"a slab is {WIDTH} wide")


def write_note(full, folder):
    """Leave a note beside a model."""
    if full.comm.rank == 0:
        (folder / "note.txt").write_text(full.scene.name)
