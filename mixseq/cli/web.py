"""Implement the command ``mixseq web``."""

from __future__ import annotations

from pathlib import Path

from mixseq.cli import options
from mixseq.cli.files import Claim
from mixseq.cli.group import announce


@options.command("web", "mixseq web --out site/mixseq", out=options.out_folder(default=Path("mixseq-web")))
def command(out: Path, claim: Claim, quiet: bool) -> None:
    """Write a JavaScript package that plays compressed models in browsers.

    The folder is an npm package with mixseq.js, the decoder; mesh_sequence.js, a plugin for three.js; types of both;
    example.html and player.html, pages with and without three.js; page.js and page.css, which both need; the schema of
    the glTF extension; and a README.
    "mixseq encode shot.usdz shot.glb --max-error 0.001" makes a file for the player.
    """
    from mixseq.web import package_files
    from mixseq_io.files import atomic_file

    files = package_files()
    out.mkdir(parents=True, exist_ok=True)
    claim(*(out / name for name in files))
    for name, text in files.items():
        with atomic_file(out / name) as temporary:
            temporary.write_text(text, encoding="utf-8", newline="\n")
    if not quiet:
        announce(out)
