"""Draw the pictures of the documentation: ``python docs/images/make.py [NAME ...]``, all of them by default.

Two of them show animals and people of other makers (Quaternius, CC0), from the folder that ``MIXSEQ_DATA`` names; they
are left out where it is not set.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping
from functools import cache
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

import mixseq
from mixseq.cli.transfer import command as transfer_command
from mixseq.compression.bitstream.compressed_sequence import decode_basis
from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.creature import part_of_vertex, walk_cycle
from mixseq.mesh.decimation import decimate
from mixseq.mesh.rotations import rotvec_to_matrix
from mixseq.mesh.triangle_mesh import area_normals
from mixseq.operations import (
    Handle,
    blend,
    concatenate,
    cut,
    exaggerate,
    exaggerate_part,
    hold,
    key_poses,
    loop,
    pose,
    repeat,
    reverse,
    sculpt,
    shift,
    sketch,
    smooth,
    speed,
    transition,
    with_body,
)
from mixseq.pictures.charts import (
    FAINT_COLOUR,
    LINE_COLOURS,
    chart_style,
    draw_embedding,
    error_map,
    import_matplotlib,
    new_page,
)
from mixseq.pictures.colours import JOINT_RED, part_colours, segmentation_colours
from mixseq.pictures.models import plot_model
from mixseq.pictures.raster import draw_mesh
from mixseq.pictures.scene import CLAY_COLOUR, INK_COLOUR, three_quarter_view
from mixseq.pictures.scene import shared_limits as limits_of
from mixseq.pictures.sheets import (
    Sheet,
    contact_sheet,
    draw_segmentation,
    opposite_views,
    transfer_sheet,
    views_aspect,
)
from mixseq.retargeting.markers import Markers
from mixseq.retargeting.transfer import Transfer, TransferSettings, plan_transfer
from mixseq.segmentation.methods import METHODS
from mixseq.sequence.sequence import join_blocks
from mixseq.signals.curve import Curve
from mixseq.signals.model import Model
from mixseq.types import Float, Index, evenly_spaced
from mixseq_io.text.markers import read_markers, write_markers

HERE = Path(__file__).parent
MARKERS = HERE.parents[1] / "scripts" / "benchmarks" / "markers"
WIDTH = 1600  # pixels of large pictures
SHEET_WIDTH = 1280  # pixels of contact sheets
MOVING_WIDTH = 1080  # pixels of the moving picture
COLOURS = 96  # of a contact sheet, which no eye misses and PNG packs well
FPS = 24


def main() -> None:
    """Draw the pictures that are asked for, or all of them."""
    for name in sys.argv[1:] or PICTURES:
        if name in NEED_DATA and "MIXSEQ_DATA" not in os.environ:
            print(f"{name}.png: left out, MIXSEQ_DATA is not set")
        else:
            PICTURES[name](HERE / f"{name}.png")


# Overviews ------------------------------------------------------------------------------------------------


def demo(path: Path) -> None:
    """Original, parts, reconstruction, new frames and errors of the exact model."""
    walk = walk_cycle()
    model = mixseq.fit(walk, exact=True)
    labels = model.decomposition.part_of_face, model.decomposition.joint_of_face
    page = BytesIO()
    contact_sheet(page, walk, model.sample(fps=2 * walk.fps), *labels)
    save(page, path, WIDTH, 256)


def parts(path: Path) -> None:
    """Parts and joints from two sides."""
    walk = walk_cycle()
    model = mixseq.fit(walk, exact=True)
    page = BytesIO()
    labels = model.decomposition.part_of_face, model.decomposition.joint_of_face
    draw_segmentation(page, walk.points[0], walk.faces, *labels)
    save(page, path, WIDTH, 256)


def moving(path: Path) -> None:
    """The moving picture of the start page: an animation, its model, and another body, at half the speed."""
    cycle = walk_cycle(frames=12, fps=12)
    points = np.concatenate([cycle.points, cycle.points[:1]])
    model = mixseq.fit(mixseq.MeshSequence.from_arrays(points, cycle.polygons, fps=12), exact=True)
    times = np.arange(2 * FPS) / (2 * FPS)
    slow = model.sample(times)
    columns = {
        "animation, 12 frames per second": (cycle.points[(times * 12).astype(int)], CLAY_COLOUR),
        "model, at any time": (slow.points, segmentation_colours(*labels_of(model), slow.faces)),
        "on another body": (mixseq.transfer(slow, long_legs()).points, CLAY_COLOUR),
    }
    view, limits, ground = camera([points for points, _ in columns.values()])
    frames = []
    for frame in range(len(times)):
        page = Sheet.from_grid(1, len(columns), (limits[3] - limits[2]) / (limits[1] - limits[0]), "")
        for ax, (title, (poses, colours)) in zip(page.panels[0], columns.items(), strict=True):
            draw_mesh(ax, poses[frame], cycle.faces, colours, "Y", view, limits, ground)
            ax.set_title(title, fontsize=17, color=INK_COLOUR, pad=2)
        stream = BytesIO()
        page.save(stream)
        picture = Image.open(stream).convert("RGB")
        size = MOVING_WIDTH, round(MOVING_WIDTH * picture.height / picture.width)
        frames.append(picture.resize(size, Image.Resampling.LANCZOS))
    path = path.with_suffix(".webp")
    frames[0].save(path, save_all=True, append_images=frames[1:], duration=1000 // FPS, loop=0, quality=55, method=6)
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


def labels_of(model: Model) -> tuple[Index, Index]:
    """Return the part and the joint ``(F,)`` of every triangle."""
    return model.decomposition.part_of_face, model.decomposition.joint_of_face


def segmentations(path: Path) -> None:
    """Parts by all methods that look at motion, from two sides."""
    walk = walk_cycle()
    columns: dict[str, tuple[Index, Index]] = {}
    for method in METHODS:
        part = mixseq.segment(walk, method)
        columns[f"{method}: {part.max() + 1} parts"] = part, np.full(len(part), -1)
    from_two_sides(path, walk, columns)


def from_two_sides(path: Path, walk: mixseq.MeshSequence, columns: Mapping[str, tuple[Index, Index]]) -> None:
    """Draw the first frame in every column with its parts and joints, both sides below each other."""
    sides = opposite_views(walk.points[:1])
    page = Sheet.from_grid(2, len(columns), views_aspect(sides), "")
    for number, (title, labels) in enumerate(columns.items()):
        for row, (view, limits) in zip(page.panels, sides[0], strict=True):
            draw_mesh(
                row[number], walk.points[0], walk.faces, segmentation_colours(*labels, walk.faces), "Y", view, limits
            )
        page.panels[0][number].set_title(title, fontsize=10, color=INK_COLOUR, pad=2)
    stream = BytesIO()
    page.save(stream)
    save(stream, path, SHEET_WIDTH, 256)


def coding(path: Path) -> None:
    """What compression codes: which vertices come first, and basis vectors of the walk."""
    walk = walk_cycle()
    coded = mixseq.compress(walk, max_error=0.0005)
    graph = mesh_graph(walk.faces, walk.vertex_count)
    vectors = decode_basis(coded, graph).vectors[1:, 0]
    points, faces = walk.points[0], walk.faces
    low, high = (0.16, 0.38, 0.58), (0.80, 0.48, 0.10)
    view, limits, _ = camera([walk.points[:1]])
    page = Sheet.from_grid(2, 4, (limits[3] - limits[2]) / (limits[1] - limits[0]), "", left=0.9)
    page.label_row(0, "coarse\nto fine")
    page.label_row(1, "basis\nvectors")
    screen = points @ view.rotation.T
    front = np.zeros(len(points), dtype=bool)
    front[faces[area_normals(screen, faces)[:, 2] > 0]] = True
    for ax, count in zip(page.panels[0], (20, 100, 500, 2500), strict=True):
        draw_mesh(ax, points, faces, CLAY_COLOUR, "Y", view, limits)
        known = graph.order[: next(batch.stop for batch in graph.batches if batch.stop >= count)]
        dots = screen[known[front[known]], :2].T
        ax.plot(*dots, "o", color=low, ms=14 / len(known) ** 0.25, mew=0, zorder=4)
        ax.set_title(f"the first {len(known)} vertices", fontsize=9, color=INK_COLOUR, pad=2)
    for ax, number in zip(page.panels[1], (0, 2, 5, 14), strict=True):
        value = vectors[number][faces].mean(axis=1)
        share = np.clip(value / np.percentile(np.abs(value), 98), -1, 1)[:, None]
        ends = np.where(share > 0, high, low)
        draw_mesh(ax, points, faces, (1 - np.abs(share)) * 0.93 + np.abs(share) * ends, "Y", view, limits)
        ax.set_title(f"$b_{{{number + 1}}}$", fontsize=9, color=INK_COLOUR, pad=2)
    stream = BytesIO()
    page.save(stream)
    save(stream, path, SHEET_WIDTH, 256)


def plot(path: Path) -> None:
    """The page of ``mixseq plot``."""
    page = BytesIO()
    plot_model(page, walk_model())
    save(page, path, SHEET_WIDTH, 256)


def embedding(path: Path) -> None:
    """The picture of ``mixseq plot --kind embedding``."""
    page = BytesIO()
    plot_model(page, walk_model(), "embedding")
    save(page, path, 800, 256)


# Motions --------------------------------------------------------------------------------------------------


@cache
def walk_model() -> Model:
    """One cycle of the walk, from 0 to 1 s, whose last frame is the first one again."""
    walk = walk_cycle(frames=FPS, fps=FPS)
    points = np.concatenate([walk.points, walk.points[:1]])
    return mixseq.fit(mixseq.MeshSequence.from_arrays(points, walk.polygons, fps=FPS, name="fox"))


@cache
def leap_model() -> Model:
    """A leap of one second, on the spot."""
    slow = walk_cycle(frames=3 * FPS, fps=FPS)
    time = np.linspace(0, 1, FPS + 1)
    turns = rotvec_to_matrix(np.stack([0 * time, 0 * time, 0.5 * np.sin(2 * np.pi * time)], axis=1))
    points = np.einsum("tij,tvj->tvi", turns, slow.points[: FPS + 1])
    points[..., 1] += (0.5 * np.sin(np.pi * time) ** 2)[:, None]
    return mixseq.fit(mixseq.MeshSequence.from_arrays(points, slow.polygons, fps=FPS, name="leap"))


def part_of(model: Model, name: str) -> int:
    """Return the part that a bone of the fox moves most."""
    bone, names = part_of_vertex()
    shares = [np.mean(bone[vertices] == names.index(name)) for vertices in model.decomposition.parts]
    return int(np.argmax(shares))


def hump(points: Float) -> Float:
    """Return the fox with a hump on its back."""
    away = np.linalg.norm(points - [-0.02, 0.68, 0.0], axis=1)
    return points + np.exp(-0.5 * np.square(away / 0.07))[:, None] * [0.0, 0.18, 0.0]


# Edits ----------------------------------------------------------------------------------------------------


def timing(path: Path) -> None:
    """Where frames go."""
    walk = walk_model()
    rows = {
        "walk": walk,
        "cut\n0.25 to 0.75 s": cut(walk, 0.25, 0.75),
        "shift\nby 0.5 s": shift(walk, 0.5),
        "speed\n2": speed(walk, 2.0),
        "reverse": reverse(walk),
    }
    sheet(path, rows, np.arange(7) / 4)


def repeated(path: Path) -> None:
    """A section twice."""
    walk = walk_model()
    rows = {"walk": walk, "repeat\n0.25 to 0.75 s,\ntwice": repeat(walk, 0.25, 0.75, times=2)}
    sheet(path, rows, np.arange(7) / 4)


def looped(path: Path) -> None:
    """Half of a cycle, whose end meets its start."""
    part = cut(walk_model(), 0.0, 0.5)
    sheet(path, {"walk\n0 to 0.5 s": part, "loop": loop(part)}, np.arange(7) / 12, against=part)


def two_motions(path: Path) -> None:
    """From one motion into another."""
    walk, leap = walk_model(), leap_model()
    rows = {
        "walk": walk,
        "leap": leap,
        "concatenate": concatenate(walk, leap),
        "transition\nat 0.5 s,\n0.5 s long": transition(walk, leap, at=0.5, duration=0.5),
        "blend\nweight 0.5": blend(walk, leap, 0.5),
    }
    sheet(path, rows, np.arange(9) / 4)


def exaggerated(path: Path) -> None:
    """More of the shape, more of a part, less of a part."""
    walk = walk_model()
    arm = part_of(walk, "arm.r")
    plain = mixseq.fit(walk.sample(), space="vertex")
    rows = {
        "walk": walk,
        "exaggerate\ngain 1.5": exaggerate(walk, 1.5),
        "exaggerate\ngain 1.5,\nvertex space": exaggerate(plain, 1.5),
        "exaggerate_part\ngain 1.8": exaggerate_part(walk, arm, 1.8),
        "hold\nas at 0 s, from\n0.25 to 0.75 s": hold(walk, arm, 0.0, 0.25, 0.75),
    }
    sheet(path, rows, np.arange(7) / 6, against=walk)


def smoothed(path: Path) -> None:
    """Without what is fast."""
    walk = walk_model()
    rows = {"walk": walk, "smooth\n0.5 s": smooth(walk, 0.5), "smooth\n1.5 s": smooth(walk, 1.5)}
    sheet(path, rows, np.arange(7) / 6, against=walk)


def sculpted(path: Path) -> None:
    """A hump made at 0.5 s, shown in three ways."""
    walk = walk_model()
    points = hump(walk(0.5))
    rows = {
        "walk": walk,
        "everywhere": sculpt(walk, 0.5, points),
        "window\n0.2 to 0.8 s": sculpt(walk, 0.5, points, where="window", start=0.2, end=0.8),
        "similar\nradius 0.5": sculpt(walk, 0.5, points, where="similar", radius=0.5),
    }
    sheet(path, rows, np.arange(7) / 6, against=walk)


def posed(path: Path) -> None:
    """A forepaw put elsewhere at 0.5 s: alone, and with the other paws kept."""
    walk, (paw, *others) = walk_model(), map(sole, ("forepaw.r", "forepaw.l", "hindpaw.r", "hindpaw.l"))
    raised = [Handle(0.5, walk(0.5)[paw] + [0.12, 0.1, 0.0], paw)]
    rows = {
        "walk": walk,
        "forepaw up\nand forwards": pose(walk, raised, fade=0.3),
        "other paws\nkept": pose(walk, raised, keep=others, fade=0.3),
    }
    sheet(path, rows, np.linspace(0.2, 0.8, 7), against=walk)


def posed_still(path: Path) -> None:
    """A fox that stands, a single mesh, gives paw and looks up."""
    still = mixseq.fit(walk_model().sample(times=[0.0]), exact=True, parts=20)
    points, (paw, *others) = still(0.0), map(sole, ("forepaw.r", "forepaw.l", "hindpaw.r", "hindpaw.l"))
    nose = int(points[:, 0].argmax())
    paw_up = Handle(1.0, points[paw] + [0.15, 0.12, 0.0], paw)
    look = Handle(1.0, points[nose] + [-0.05, 0.1, 0.1], nose)
    sheet(path, {"a still,\nposed at 1 s": pose(still, [paw_up, look], keep=others)}, np.linspace(0.0, 1.0, 5))


def sole(bone_name: str) -> int:
    """Return the lowest vertex of a bone of the fox at rest."""
    bone, names = part_of_vertex()
    vertices = np.flatnonzero(bone == names.index(bone_name))
    return int(vertices[walk_model()(0.0)[vertices, 1].argmin()])


def sketched(path: Path) -> None:
    """A curve in the layout, and the motion that it tells."""
    walk = walk_model()
    angles = np.linspace(0, 2 * np.pi, 13)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    drawn = sketch(walk, circle, duration=1.0)
    times = np.arange(6) / 6
    with chart_style():
        figure = import_matplotlib("figure").Figure(figsize=(12, 4.6))
        ax = figure.add_axes((0.06, 0.12, 0.38, 0.78))
        draw_embedding(ax, walk, [])
        ax.set_title("Layout of the walk; the drawn curve in red")
        ax.plot(*Curve(angles, circle)(np.linspace(0, 2 * np.pi, 200)).T, color=JOINT_RED, linewidth=2, zorder=5)
        view, limits, ground = camera([drawn.sample(times).points])
        for number, (time, place) in enumerate(zip(times, circle[::2], strict=False)):
            ax.plot(*place, "o", color=JOINT_RED, markersize=7, zorder=6)
            text, offset = f"{time:.2f} s", -22 * circle[2 * number]
            ax.annotate(text, place, offset, textcoords="offset points", color=JOINT_RED, ha="center", va="center")
            panel = figure.add_axes((0.54 + 0.153 * (number % 3), 0.5 - 0.47 * (number // 3), 0.15, 0.45))
            draw_mesh(panel, drawn(time), drawn.header.faces, CLAY_COLOUR, "Y", view, limits, ground)
            panel.set_title(text, fontsize=9, color=INK_COLOUR)
        page = BytesIO()
        figure.savefig(page, format="png", dpi=150)
    save(page, path, SHEET_WIDTH, 256)


# Engines --------------------------------------------------------------------------------------------------


def engines(path: Path) -> None:
    """A skin of the walk: its bones in colours, and how far it is off."""
    walk = walk_model().sample()
    skin = mixseq.fit_skin(walk, bones=16)
    bones = part_colours(skin.bone_count)
    shares = np.einsum("vk,vkc->vc", skin.weights, bones[skin.influences])[walk.faces].mean(axis=1)
    frames = evenly_spaced(FPS + 1, 5)[1:]
    skinned = skin.points()[frames]
    errors = np.linalg.norm(skinned - walk.points[frames], axis=2) / walk.diagonal
    colour_map = error_map(errors.max())
    view, limits, ground = camera([walk.points[frames], skinned])
    page = Sheet.from_grid(3, len(frames), (limits[3] - limits[2]) / (limits[1] - limits[0]), "", left=1.4, right=1.0)
    for row, label in enumerate(("cache", f"skin,\n{len(bones)} bones", "error of\nthe skin")):
        page.label_row(row, label)
        for column, frame in enumerate(frames):
            heat = colour_map.to_rgba(errors[column][walk.faces].mean(axis=1))[:, :3]
            points, colours = (
                (walk.points[frame], CLAY_COLOUR) if row == 0 else (skinned[column], (shares, heat)[row - 1])
            )
            draw_mesh(page.panels[row][column], points, walk.faces, colours, "Y", view, limits, ground)
    page.add_colour_bar(colour_map, "vertex error / diagonal")
    stream = BytesIO()
    page.save(stream)
    save(stream, path, SHEET_WIDTH, 256)


# Transfers ------------------------------------------------------------------------------------------------


def transfer_fox(path: Path) -> None:
    """The walk on long legs."""
    made = plan_transfer(walk_cycle(frames=FPS, fps=FPS), long_legs())
    frames = evenly_spaced(FPS, 5)[1:]
    page, points = BytesIO(), np.concatenate(list(made.blocks()))
    transfer_sheet(page, made, frames, points[list(frames)], "The walk of the fox, on long legs")
    save(page, path, SHEET_WIDTH, 256)


def transfer_wolf(path: Path) -> None:
    """The wolf's gallop on the horse."""
    wolf = "gltf/Wolf.glb"
    options = "--animation", "Gallop", "--rest", *of_data(wolf), "--markers", f"{MARKERS / 'wolf_horse.txt'}"
    transferred(path, *of_data(wolf, "gltf/Horse.glb"), *options)


def transfer_exchanged(path: Path) -> None:
    """The same with exchanged markers of the hind legs."""
    markers = read_markers(MARKERS / "wolf_horse.txt")
    legs = [
        [markers.names.index(f"{side} hind toe"), markers.names.index(f"{side} hock")] for side in ("left", "right")
    ]
    target = markers.target.copy()
    target[[*legs[0], *legs[1]]] = markers.target[[*legs[1], *legs[0]]]
    with TemporaryDirectory() as folder:
        write_markers(Path(folder) / "exchanged.txt", Markers(markers.source, target, markers.names))
        options = "--animation", "Gallop", "--markers", f"{folder}/exchanged.txt"
        transferred(path, *of_data("gltf/Wolf.glb", "gltf/Horse.glb"), *options)


def transfer_man(path: Path) -> None:
    """The man's run on the woman."""
    options = "--up-axis", "Z", "--markers", f"{MARKERS / 'man_woman.txt'}"
    transferred(path, *of_data("npz/q_man_run.npz", "npz/q_woman_run.npz"), *options)


def contacts(path: Path) -> None:
    """How fast the paws of the fox on long legs are, with and without contacts."""
    walk = walk_cycle(frames=FPS, fps=FPS)
    ahead = np.arange(FPS)[:, None, None] / FPS * [0.469, 0.0, 0.0]
    walk = mixseq.MeshSequence.from_arrays(walk.points + ahead, walk.polygons, fps=FPS)
    bone, names = part_of_vertex()
    feet = {
        f"{where} {side}": np.flatnonzero(bone == names.index(f"{where}paw.{side[0]}"))
        for where in ("fore", "hind")
        for side in ("left", "right")
    }
    free, planted = (plan_transfer(walk, long_legs(), TransferSettings(contacts=given)) for given in (None, feet))
    with chart_style():
        figure = new_page(12, 2.9, "")
        panels = figure.subplots(1, len(feet), sharey=True)
        for ax, group in zip(panels, planted.contacts.groups, strict=True):
            for stance in group.stances:
                ax.axvspan(stance.start / FPS, (stance.stop - 1) / FPS, color=FAINT_COLOUR, alpha=0.35, linewidth=0)
            for made, colour, label in (
                (free, LINE_COLOURS[1], "without contacts"),
                (planted, LINE_COLOURS[0], "with contacts"),
            ):
                middle = middles(made, feet[group.name])
                speeds = FPS * np.linalg.norm(np.diff(middle, axis=0), axis=1)
                ax.plot((np.arange(FPS - 1) + 0.5) / FPS, speeds, color=colour, label=label)
            ax.set_title(group.name)
            ax.set_xlabel("seconds")
        panels[0].set_ylabel("speed, m/s")
        panels[0].legend()
        page = BytesIO()
        figure.savefig(page, format="png", dpi=150)
    save(page, path, SHEET_WIDTH, COLOURS)


def middles(made: Transfer, vertices: Index) -> Float:
    """Return the middle ``(T, 3)`` of some vertices of the target."""
    return np.concatenate([block[:, vertices].mean(axis=1) for block in made.blocks()])


@cache
def long_legs() -> mixseq.MeshSequence:
    """The fox in the first frame of its walk, with legs half as long again, and thicker."""
    walk = walk_cycle(frames=FPS, fps=FPS)
    x, y, z = walk.points[0].T
    points = np.stack([x, y + 0.5 * np.minimum(y, 0.45), 1.3 * z], axis=1)
    return mixseq.MeshSequence.from_arrays(points[None], walk.polygons, name="long legs")


def bodies(path: Path) -> None:
    """A walk and its edit on three bodies, one of which has other triangles."""
    fox = mixseq.fit(walk_cycle(frames=FPS, fps=FPS), exact=True)
    plan = plan_transfer(key_poses(fox), long_legs())
    herd = with_body(fox, join_blocks(plan.header, plan.blocks()), "long legs")
    kept, faces = decimate(long_legs().points[0], fox.header.faces.astype(int), 700)
    low = mixseq.MeshSequence.from_arrays(long_legs().points[:, kept] * [1.2, 0.6, 1.5], faces, name="low")
    pairs = np.stack([kept, np.arange(len(kept))], axis=1)[::10]
    plan = plan_transfer(key_poses(fox), low, TransferSettings(pairs))
    labels = plan.method.parts.labels if plan.method.parts else None
    herd = with_body(herd, join_blocks(plan.header, plan.blocks()), "low", labels)
    edited = exaggerate(herd, 1.6)
    rows = {
        f"{name}{edit}": model.body(name)
        for name in herd.body_names
        for edit, model in (("", herd), (", edited", edited))
    }
    sheet(path, rows, np.arange(1, FPS, 4) / FPS)


def of_data(*names: str) -> list[str]:
    """Return paths of files in the folder of animations of other makers."""
    return [str(Path(os.environ["MIXSEQ_DATA"], name)) for name in names]


def transferred(path: Path, source: str, target: str, *options: str) -> None:
    """Take the picture that ``mixseq transfer`` draws."""
    with TemporaryDirectory() as folder:
        out, picture = str(Path(folder, "out.npz")), Path(folder, "out.png")
        arguments = [source, target, out, *options, "--picture", str(picture), "--quiet"]
        transfer_command.main(arguments, standalone_mode=False)
        page = BytesIO(picture.read_bytes())
    save(page, path, SHEET_WIDTH, 256)


NEED_DATA = ("transfer-wolf", "transfer-exchanged", "transfer-man")

PICTURES: Mapping[str, Callable[[Path], None]] = {
    "demo": demo,
    "parts": parts,
    "walk": moving,
    "segmentations": segmentations,
    "coding": coding,
    "plot": plot,
    "embedding": embedding,
    "edit-timing": timing,
    "edit-repeat": repeated,
    "edit-loop": looped,
    "edit-two-motions": two_motions,
    "edit-limbs": exaggerated,
    "edit-smooth": smoothed,
    "edit-sculpt": sculpted,
    "edit-pose": posed,
    "pose-still": posed_still,
    "edit-sketch": sketched,
    "engines": engines,
    "transfer-fox": transfer_fox,
    "bodies": bodies,
    "transfer-wolf": transfer_wolf,
    "transfer-exchanged": transfer_exchanged,
    "transfer-man": transfer_man,
    "transfer-contacts": contacts,
}


# Sheets ---------------------------------------------------------------------------------------------------


def sheet(path: Path, rows: Mapping[str, Model], times: Float, against: Model | None = None) -> None:
    """Draw models one below the other, at the same times in each column where they last.

    Vertices that are not where another model has them are red.
    """
    poses = {
        (row, column): model(time)
        for row, model in enumerate(rows.values())
        for column, time in enumerate(times)
        if model.start - 1e-9 <= time <= model.end + 1e-9
    }
    view, limits, ground = camera([points[None] for points in poses.values()])
    aspect = (limits[3] - limits[2]) / (limits[1] - limits[0])
    page = Sheet.from_grid(len(rows), len(times), aspect, "", left=1.4)
    for number, label in enumerate(rows):
        page.label_row(number, label)
    for (row, column), points in poses.items():
        ax, faces = page.panels[row][column], list(rows.values())[row].header.faces
        colours = np.tile(CLAY_COLOUR, (len(faces), 1))
        if against is not None and row:
            off = np.linalg.norm(points - against(times[column]), axis=1)[faces].mean(axis=1)
            share = np.clip(off / 0.05, 0, 1)[:, None]
            colours = (1 - share) * colours + share * np.array(JOINT_RED)
        draw_mesh(ax, points, faces, colours, "Y", view, limits, ground)
    for column, time in enumerate(times):
        page.panels[0][column].set_title(f"{time:.3g} s", fontsize=9, color=INK_COLOUR, pad=2)
    stream = BytesIO()
    page.save(stream)
    save(stream, path, SHEET_WIDTH, COLOURS)


def camera(poses: list[Float]) -> tuple[object, tuple[float, float, float, float], float]:
    """Return a view, limits and a ground for all poses ``(T, V, 3)`` together."""
    view, points = three_quarter_view(poses[0][0]), np.concatenate([each.reshape(-1, 3) for each in poses])
    return view, limits_of(points, "Y", view), float(points[:, 1].min())


def save(page: BytesIO, path: Path, width: int, colours: int) -> None:
    """Shrink a page to a width and to so many colours."""
    picture = Image.open(page).convert("RGB")
    smaller = picture.resize((width, round(width * picture.height / picture.width)), Image.Resampling.LANCZOS)
    packed = smaller.quantize(colours, method=Image.Quantize.MAXCOVERAGE, kmeans=3, dither=Image.Dither.NONE)
    packed.save(path, optimize=True)
    print(f"{path.name}: {path.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
