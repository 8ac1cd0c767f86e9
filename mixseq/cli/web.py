"""``mixseq web``."""

from __future__ import annotations

from pathlib import Path

import click

from mixseq.cli.files import Claim, overwrite_option
from mixseq.cli.group import announce
from mixseq.cli.options import FILE, CommandWithSettings, examples, quiet_option


@click.command("web", cls=CommandWithSettings, epilog=examples("mixseq web --out site/mixseq"))
@click.option(
    "--out",
    type=FILE,
    default=Path("mixseq-web"),
    show_default=True,
    help="Folder for the files, made if missing.",
)
@overwrite_option
@quiet_option
def command(out: Path, claim: Claim, quiet: bool) -> None:
    """Write what plays compressed models in browsers.

    Leaves in the folder, which npm takes as a package: mixseq.js, the decoder; mesh_sequence.js, a plugin for three.js;
    types of both; example.html and player.html, pages with and without three.js; the schema of the glTF extension; and
    a README. "mixseq encode shot.usdz shot.glb --max-error 0.001" makes files for it.
    """
    from mixseq.web import contents
    from mixseq_io.files import replacing

    files = contents()
    out.mkdir(parents=True, exist_ok=True)
    claim(*(out / name for name in files))
    for name, text in files.items():
        with replacing(out / name) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    if not quiet:
        announce(out)
