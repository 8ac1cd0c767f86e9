"""``mixseq batch``: a folder of assets, with one report."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from mixseq.cli.compressed import aim_options
from mixseq.cli.console import print_table, progress_bar, say
from mixseq.cli.files import options_of
from mixseq.cli.options import FILE, examples, fit_options, quiet_option, reader_options, workers_options
from mixseq.cli.overwriting import Claim, overwrite_option
from mixseq.cli.settings import CommandWithSettings
from mixseq.errors import OutputError, SettingsError

if TYPE_CHECKING:
    from mixseq.mapping import Executor


@click.command(
    "batch",
    cls=CommandWithSettings,
    epilog=examples(
        "mixseq batch shots/*.usdc --out models",
        "mixseq batch shots --out models --tolerance 0.001",
        "mixseq batch shots --out small --max-error 0.001",
        "mixseq batch shots --out models --cluster tcp://host:8786",
    ),
)
@click.argument("caches", nargs=-1, required=True, type=FILE)
@click.option("--out", required=True, type=FILE, metavar="FOLDER", help="Folder for models and report.")
@click.option("--force", is_flag=True, help="Encode everything again, also what is done.")
@aim_options
@fit_options
@workers_options
@reader_options
@overwrite_option
@quiet_option
@click.pass_context
def command(
    context: click.Context,
    caches: tuple[Path, ...],
    out: Path,
    force: bool,
    aim: dict[str, Any],
    fitting: dict[str, Any],
    workers: AbstractContextManager[Executor],
    reading: dict[str, Any],
    claim: Claim,
    quiet: bool,
) -> None:
    """Turn many sequences into models, with one report.

    CACHES are sequences in any format, or folders of them. Each becomes a model in the folder, is decoded and compared.
    The report, report.json and report.md there, is up to date after every asset. A failure does not stop the others.

    The same command goes on where it was interrupted, and does again only what failed or has changed. Files in the
    folder that no batch has made are not replaced unless --overwrite says so, or you on a terminal.

    With --max-error, --kg or --size every model is compressed, each of them so far, see "mixseq encode".
    """
    if fitting["exact"] + (fitting["tolerance"] is not None) + (fitting["rank"] is not None) > 1:
        raise SettingsError("--exact, --tolerance and --rank exclude each other; give one of them")
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out} is a file; give the name of a folder")
    from mixseq.cli.batch.plan import find_sources, plan
    from mixseq.cli.batch.report import HEADING, read_report, rows
    from mixseq.cli.batch.work import in_turn, on_cluster, run
    from mixseq.cluster import Cluster

    read_with = {
        name: str(value.resolve()) if isinstance(value, Path) else value for name, value in reading.items()
    }
    settings = {**({"aim": aim} if aim else fitting), "reading": read_with}
    earlier = read_report(out).without_lost()
    names = {source: Path(entry.target).name for source, entry in earlier.entries.items()}
    assets = plan(find_sources(caches), out, names)
    for name in reading:
        if not any(name in options_of(asset.source, reading) for asset in assets):
            raise SettingsError(f"none of the sequences is read with an option {name!r}")
    claim.permit(earlier.of_others(assets, out), unasked=False)
    _make(out)
    with workers as mapped, progress_bar(quiet) as progress:
        work = on_cluster(mapped, progress) if isinstance(mapped, Cluster) else in_turn(mapped, progress)
        report = run(assets, settings, earlier, out.resolve(), work, force)
    ours = report.of(assets)
    if not quiet:
        print_table(rows(ours.entries.values()), HEADING)
    say(f"wrote {click.format_filename(out / 'report.md')} ({ours.summary()})")
    if ours.count("done") < len(assets):
        context.exit(1)


def _make(folder: Path) -> None:
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder {folder}: {error.strerror}; choose another one") from error
