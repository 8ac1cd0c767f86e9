"""``mixseq batch``: run a command for many assets, in processes or on a cluster, and report after every asset.

An asset is run as the command line of its job, with the options that were given to the batch.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import (
    AbstractContextManager,
    closing,
    contextmanager,
    nullcontext,
    redirect_stderr,
    redirect_stdout,
    suppress,
)
from dataclasses import dataclass, replace
from importlib import import_module
from io import StringIO
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any, Literal, NoReturn

import click

import mixseq
from mixseq.cli import options
from mixseq.cli.batch_report import (
    Entry,
    Report,
    Settings,
    files_of,
    find_sources,
    plan,
    read_report,
    rows,
    size_and_hash,
    write_report,
)
from mixseq.cli.files import VAT_EXTENSION, Claim, check_options, decoded
from mixseq.cli.group import print_table, progress_bar, say
from mixseq.cli.options import READING_OPTIONS, argument, option, setting
from mixseq.errors import FormatError, GivenUpError, MissingFileError, MixseqError, MixseqWarning, OutputError
from mixseq.runtime.progress import Progress, log_progress

if TYPE_CHECKING:
    from mixseq.runtime.cluster import ClusterExecutor
    from mixseq.runtime.parallel import Executor
    from mixseq.runtime.processes import ProcessPool


@dataclass(frozen=True)
class Job:
    """A command that a batch can run: its first argument is an asset, its last the file to write."""

    reads: tuple[Literal["sequences", "models"], ...]  # what is taken from folders
    extension: str | None = None  # extension of the files; None for that of the asset


JOBS = {
    "encode": Job(("sequences",), ".h5"),
    "convert": Job(("sequences",)),
    "decode": Job(("models",), ".usdc"),
    "resample": Job(("sequences", "models")),
    "edit": Job(("sequences", "models"), ".h5"),
    "transfer": Job(("sequences", "models")),
    "segment": Job(("sequences",), ".npz"),
}

_OMITTED_OPTIONS = (
    "set",
    "quiet",
    "overwrite",
    "threads",
    "cluster",
    "as_json",
    "check",
    "picture",
    "save_map",
    "travel",
)
"""Options of commands that a batch has itself, or whose file all assets would write."""


Work = Callable[[Sequence[Entry]], Generator[tuple[Entry, Callable[[], Entry]], None, None]]
"""Function that runs assets and yields each finished asset with a function that returns its result."""


def run(assets: Iterable[Entry], earlier: Report, out: Path, work: Work, force: bool) -> Report:
    """Run the assets without valid results, and return the report; write it at the start and after every asset."""
    with _alone(out):
        pending = []
        entries: dict[str, Entry] = {}
        for asset in assets:
            before = earlier.entries.get(asset.target)
            if before is None or force or not before.holds_for(asset):
                before = replace(asset, target_signature=before.target_signature if before else None)
                pending.append(before)
            entries[asset.target] = before
        report = Report(entries | {key: entry for key, entry in earlier.entries.items() if key not in entries})
        write_report(out, report)
        with closing(work(pending)) as finished:
            for asset, result in finished:
                report = report.with_entry(_entry(asset, result))
                write_report(out, report)
        report = replace(report, finished=not report.of(entries.values()).count("left"))
        write_report(out, report)
        return report


@contextmanager
def _alone(out: Path) -> Iterator[None]:
    """Lock a folder while a batch writes there; the system releases the lock if the process dies."""
    try:
        import fcntl
    except ImportError:  # Windows has no such locks
        yield
        return
    folder = os.open(out, os.O_RDONLY)
    try:
        fcntl.flock(folder, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        os.close(folder)
        raise OutputError(f"{out}: another batch is writing here; wait for it, or give another --out") from None
    try:
        yield
    finally:
        os.close(folder)


def _entry(asset: Entry, result: Callable[[], Entry]) -> Entry:
    try:
        entry = result()
    except GivenUpError as error:
        entry = replace(asset, state="failed", message=str(error))
    if entry.state == "failed" and files_of(asset.path):
        return replace(entry, message=f"{entry.message}; an older file is left at {asset.path.name}")
    return entry


def on_workers(workers: ClusterExecutor | ProcessPool | None, progress: Progress) -> Work:
    """Return a function that runs an asset on each worker, by default in as many processes as there are threads."""
    from mixseq.runtime.parallel import thread_count
    from mixseq.runtime.processes import process_pool

    def work(assets: Sequence[Entry]) -> Generator[tuple[Entry, Callable[[], Entry]], None, None]:
        # The largest first, so that all workers end at about the same time.
        waiting = sorted(assets, key=lambda asset: -asset.source_bytes)
        count = max(1, min(thread_count(), len(assets)))
        pool: AbstractContextManager[ClusterExecutor | ProcessPool]
        pool = nullcontext(workers) if workers else process_pool(count, max(1, thread_count() // count))
        progress(0, len(assets), "assets")
        with pool as processes:
            for done, item in enumerate(processes.as_completed(run_asset, None, waiting), start=1):
                yield item
                progress(done, len(assets), f"assets, {item[0].name}")

    return work


def run_asset(_: object, asset: Entry) -> Entry:
    """Run the command of an asset, and measure what it wrote; store its output, warnings and errors in the entry."""
    output = StringIO()
    try:
        with (
            warnings.catch_warnings(record=True) as caught,
            redirect_stdout(output),
            redirect_stderr(StringIO()),  # no progress
        ):
            warnings.simplefilter("always", MixseqWarning)
            start = perf_counter()
            _invoke(asset)
            seconds = perf_counter() - start
        messages = tuple(str(each.message) for each in caught if issubclass(each.category, MixseqWarning))
        lines = tuple(output.getvalue().splitlines())
        size, signature = size_and_hash(files_of(asset.path))
        done = replace(asset, state="done", seconds=seconds, bytes=size, target_signature=signature, output=lines)
        return replace(done, warnings=messages, **_measure(done))
    except MixseqError as error:
        message = str(error)
    except click.ClickException as error:
        message = error.format_message()
    except OSError as error:
        message = f"{error.filename or asset.source}: {error.strerror or error}"
    except MemoryError:
        message = "there is not enough memory"
    except Exception as error:
        # A bug in mixseq; the batch continues with the next asset.
        job = asset.settings["job"]
        message = f"a bug in mixseq, {type(error).__name__}: {error}; `mixseq {job}` prints more, please report it"
    return replace(asset, state="failed", message=" ".join(message.split()))


def _measure(asset: Entry) -> dict[str, Any]:
    """Return the dimensions of a written sequence, and the errors of a model that the asset was encoded to."""
    from mixseq.runtime.parallel import thread_executor

    measured: dict[str, Any] = {}
    with warnings.catch_warnings(), suppress(FormatError):  # labels of faces are no sequence
        warnings.simplefilter("ignore", MixseqWarning)
        if asset.settings["job"] != "encode":
            with mixseq.open_sequence(asset.path) as reader:
                frames, vertices = reader.header.frame_count, reader.header.vertex_count
        else:
            given = _context(asset).params
            reading = {name: value for name in READING_OPTIONS.values() if (value := given.get(name)) is not None}
            model = mixseq.load(asset.path)
            with mixseq.open_sequence(Path(asset.source), **reading) as reader:
                error = mixseq.compare(reader, decoded(model, log_progress, thread_executor()))
                frames, vertices = error.frames, error.vertices
                measured |= {
                    "max_error": error.as_dict()["max_error"],
                    "diagonal": error.diagonal * reader.header.metres_per_unit,
                    "kg_percent": error.as_dict()["kg_percent"],
                    "history": str(model.header.provenance or ""),
                }
        measured |= {"frames": frames, "vertices": vertices, "bits": 8 * (asset.bytes or 0) / (frames * vertices)}
    return measured


# Command --------------------------------------------------------------------------------------------------


def job_command(name: str) -> options.CommandWithSettings:
    """Return the command that a job runs."""
    command: options.CommandWithSettings = import_module(f"mixseq.cli.{name}").command
    return command


def _context(asset: Entry, claim: Callable[..., None] | None = None) -> click.Context:
    """Parse the arguments of an asset's command; it has its own checks of files if there is no other `claim`."""
    command = job_command(asset.settings["job"])
    return command.make_context(command.name, asset.arguments(), obj=claim, help_option_names=options.HELP_OPTIONS)


def _invoke(asset: Entry, claim: Callable[..., None] | None = None) -> None:
    """Run the command of an asset."""
    with _context(asset, claim) as context:
        context.command.invoke(context)


class BatchCommand(options.CommandWithSettings):
    """A command whose first argument is a job, of which it takes the options."""

    def make_context(
        self, info_name: str | None, args: list[str], parent: click.Context | None = None, **extra: Any
    ) -> click.Context:
        """Parse the arguments, those of a job with its options."""
        if args[:1] and args[0] in JOBS:
            return _JobCommand(self, args[0]).make_context(f"{info_name} {args[0]}", args[1:], parent, **extra)
        return super().make_context(info_name, args, parent, **extra)


class _JobCommand(options.CommandWithSettings):
    """A batch of one job, with the options of both."""

    def __init__(self, batch: BatchCommand, name: str) -> None:
        job = job_command(name)
        arguments = [each for each in job.params if isinstance(each, click.Argument)]
        self._between = [str(each.name) for each in arguments[1:-1]]
        own = [each for each in batch.params if each.name not in ("job", "set")]
        names = {*_OMITTED_OPTIONS, *(each.name for each in own)}
        self._options = [
            *(_required_option(each) for each in arguments[1:-1]),
            *(each for each in job.params if isinstance(each, click.Option) and each.name not in names),
        ]
        super().__init__(
            f"{batch.name} {name}",
            params=[*own, *self._options],
            callback=batch.callback,
            help=f"Run mixseq {name} for many assets, with one report.\n\nSee mixseq batch --help and "
            f"mixseq {name} --help.",
            epilog=options.examples(f"mixseq batch {name} shots --out {name}d"),
        )
        self._job = name

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Parse the arguments, and keep the options of the job as they are for its own command line."""
        expanded = list(self._expanded(ctx, args)) if self.settings else args
        texts, _, _ = self.make_parser(ctx).parse_args(args=list(expanded))
        rest = super().parse_args(ctx, args)
        if ctx.resilient_parsing:
            return rest
        given = {str(each.name): _spell(each, texts[each.name]) for each in self._options if each.name in texts}
        between = [str(ctx.params[name].absolute()) for name in self._between]
        files = [Path(text) for each in self._options for text in _paths(each, texts.get(each.name))]
        ctx.params = {each: value for each, value in ctx.params.items() if each not in {o.name for o in self._options}}
        ctx.params |= {
            "job": self._job,
            "settings": {
                "job": self._job,
                "between": between,
                "options": {name: each for name, each in given.items() if name not in self._between},
                "files": size_and_hash(file for path in files for file in files_of(path))[1],
            },
        }
        return rest


def _required_option(argument: click.Argument) -> click.Option:
    """Return an option in place of an argument that all assets share."""
    return click.Option(
        [f"--{argument.name}"],
        type=argument.type,
        required=True,
        metavar="FILE",
        help=f"{str(argument.name).upper()} of all assets.",
    )


def _spell(option: click.Option, value: Any) -> list[str]:
    """Return the command-line arguments that give an option a value; paths are absolute."""
    if option.is_flag:
        return [(option.opts if value else option.secondary_opts)[-1]]
    is_path = isinstance(option.type, click.Path)
    values = value if option.multiple else [value]
    return [f"{option.opts[-1]}={Path(text).absolute() if is_path else text}" for text in values]


def _paths(option: click.Option, value: Any) -> list[str]:
    if value is None or not isinstance(option.type, click.Path):
        return []
    return list(value) if option.multiple else [value]


class _AcceptedError(Exception):
    """Raised where a command would begin to work."""


def _check_arguments(assets: Iterable[Entry]) -> None:
    """Run the commands of assets up to their work, so that wrong options are errors of the batch."""

    def accept(*targets: Path | None, read: Iterable[Path | None] = ()) -> NoReturn:
        raise _AcceptedError

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", MixseqWarning)
        for asset in assets:
            with suppress(_AcceptedError, FormatError, MissingFileError):
                _invoke(asset, accept)


def _extension(text: str) -> str:
    from mixseq_io.registry import FORMATS

    extension = f".{text.lower().removeprefix('.')}"
    known = [*(each for form in FORMATS for each in form.extensions), VAT_EXTENSION]
    if extension not in known:
        raise click.BadParameter(f"{text!r} is none of {', '.join(each[1:] for each in known)}")
    return extension


@options.command(
    "batch",
    "mixseq batch encode shots/*.usdc --out models",
    "mixseq batch convert shots --out caches --format abc",
    "mixseq batch encode shots --out models --cluster tcp://host:8786",
    cls=BatchCommand,
    job=argument(type=click.Choice(list(JOBS))),
    assets=argument(nargs=-1, required=True),
    out=option("--out FOLDER", "Folder for the files and the report.", required=True),
    extension=option(
        "--format EXTENSION",
        "Format of the files: usdc, abc, glb, ...  [default: h5 of encode and edit, usdc of decode, npz of "
        "segment, else as the asset]",
        type=_extension,
    ),
    force=setting("--force", "Do everything again, also what is done."),
)
def command(
    job: str,
    assets: tuple[Path, ...],
    out: Path,
    extension: str | None,
    force: bool,
    workers: AbstractContextManager[Executor],
    claim: Claim,
    quiet: bool,
    settings: Settings | None = None,
) -> None:
    """Run a command for many sequences or models, with one report.

    JOB is the command, and its options are options of the batch: see "mixseq batch JOB --help". ASSETS are files in any
    format, or folders of sequences (of models, for decode). Every asset becomes a file in the output folder;
    report.json and report.md there are updated. Encoded models are compared with their sequences. If an asset fails,
    the batch continues.

    As many assets as there are cores are worked on at the same time, in a process each.

    After an interruption, run the same command again: it does only what is missing, failed or has changed. Files that
    no batch has made are replaced only with --overwrite, or if you agree on a terminal.
    """
    if out.exists() and not out.is_dir():
        raise OutputError(f"{out} is a file; give the name of a folder")
    from mixseq.runtime.cluster import ClusterExecutor
    from mixseq.runtime.processes import ProcessPool

    settings = settings or {"job": job, "between": [], "options": {}, "files": size_and_hash([])[1]}
    earlier = read_report(out).without_lost()
    sources = find_sources(assets, JOBS[job].reads)
    planned = plan(sources, out, earlier.entries.values(), settings, extension or JOBS[job].extension)
    given = {text.partition("=")[0] for texts in settings["options"].values() for text in texts}
    check_options(
        sources, {name: None for text, name in READING_OPTIONS.items() if text in given}, "none of the sequences is"
    )
    _check_arguments(planned)
    claim.permit(earlier.of_others(planned, out), unasked=False)
    try:
        out.mkdir(exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot make the folder {out}: {error.strerror}; choose another one") from error
    with workers as mapped, progress_bar(quiet) as progress:
        cluster = mapped if isinstance(mapped, ClusterExecutor | ProcessPool) else None
        report = run(planned, earlier, out.resolve(), on_workers(cluster, progress), force)
    results = report.of(planned)
    if not quiet:
        heading, *table = rows(results.entries.values())
        print_table(table, heading)
    say(f"wrote {click.format_filename(out / 'report.md')} ({results.summary()})")
    if results.count("done") < len(planned):
        click.get_current_context().exit(1)
