"""Taking nodes of a glTF document from where they hang, and what of them moved."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from mixseq_io.gltf.buffers import Json, append
from mixseq_io.gltf.scene import Scene

_OF_THE_MESH = ("name", "mesh", "extras")
_OF_THE_OLD_MESH = ("skin", "weights")
_WORTH_A_NODE = ("children", "camera", "extensions")
_OF_A_GROUP = {"name", "matrix", "translation", "rotation", "scale"}


def detach(document: Json, node: int, in_place: bool = False) -> None:
    """Take a node with a mesh out of the tree, without its transform; what else it was, a new node is in its place.

    A new node is needed if it had children, was a joint, had a camera or a light.

    Parameters
    ----------
    document : dict
        The document; it is changed.
    node : int
        The node.
    in_place : bool
        Whether it stays in the tree, before the new node; nothing above it may move it.
    """
    entry = document["nodes"][node]
    rest = {key: entry.pop(key) for key in list(entry) if key not in _OF_THE_MESH}
    stays = {key: value for key, value in rest.items() if key not in _OF_THE_OLD_MESH}
    skins = [
        skin for skin in document.get("skins", ()) if node in skin["joints"] or node == skin.get("skeleton")
    ]
    place: list[int] = []
    if skins or any(key in stays for key in _WORTH_A_NODE):
        name = {"name": entry["name"]} if "name" in entry else {}
        place = [append(document, "nodes", {**name, **stays})]
    here = [node, *place] if in_place else place
    for each in document["nodes"]:
        _replace(each, "children", node, here)
    for each in document.get("scenes", ()):
        _replace(each, "nodes", node, here)
    for skin in skins:
        skin["joints"] = [place[0] if joint == node else joint for joint in skin["joints"]]
        if skin.get("skeleton") == node:
            skin["skeleton"] = place[0]


def vacant(document: Json, scene: Scene, above: Collection[int]) -> int | None:
    """Return the node that was above all that was detached if it is a root and of no more use, else None.

    Where a file was written by mixseq, that is the one which `group` had made.
    """
    if len(above) != 1 or min(above) < 0 or scene.parents[min(above)] >= 0:
        return None
    (node,) = above
    joints = {
        joint for skin in document.get("skins", ()) for joint in (*skin["joints"], skin.get("skeleton"))
    }
    return node if node not in joints and set(document["nodes"][node]) <= _OF_A_GROUP else None


def _replace(owner: Json, key: str, node: int, place: Sequence[int]) -> None:
    """Put what is in a node's place into a list of nodes; without any the list may vanish, as it must not be empty."""
    if node in owner.get(key, ()):
        owner[key] = [new for old in owner[key] for new in (place if old == node else [old])]
        if not owner[key]:
            del owner[key]


def moved_by_animations(document: Json, animations: Sequence[Json], scene: Scene) -> set[int]:
    """Return the nodes with something to see that animations move: meshes, cameras, lights."""
    targets = {channel["target"].get("node") for each in animations for channel in each["channels"]}
    moved = set()
    for node in scene.paths:
        entry = document["nodes"][node]
        bearers = [node]
        if "skin" in entry:
            bearers += document["skins"][entry["skin"]]["joints"]
        if any(key in entry for key in ("mesh", "camera", "extensions")) and any(
            not targets.isdisjoint(scene.above(bearer)) for bearer in bearers
        ):
            moved.add(node)
    return moved
