"""What the paper prints: Tables 1 to 4 and the times of Figure 15. Times in milliseconds, of C++ on four cores.

S. Marras, T. J. Cashman, K. Hormann: Efficient interpolation of articulated shapes using mixed shape spaces, 2013;
an Intel Q9550 at 2.83 GHz. Of its meshes, the standing elephant and the armadillo are not among our data.
"""

from __future__ import annotations

from typing import NamedTuple


class Speeds(NamedTuple):
    """A row of Table 1."""

    faces: int
    vertices: int
    msgi_init: int
    msgi_interpolation: int
    msgi_total: int
    dso_iterations: int
    dso_iteration: int
    dso_total: int
    align: int
    init: int
    interpolation: int
    stitching: int
    total: int
    speed_up: float  # total of MSGI over total of MixIT


class Dimensions(NamedTuple):
    """A row of Table 2."""

    edge: int
    mixed: int
    ratio: float


class Variant(NamedTuple):
    """A row of Table 3 or 4: times of MixIT, and the dimension of its space."""

    align: int
    init: int
    interpolation: int
    stitching: int
    total: int
    dimension: int


TABLE_1 = {
    "lion": Speeds(9996, 5000, 112, 1305, 1417, 25, 529, 13217, 0, 12, 189, 237, 438, 3.2),
    "cat": Speeds(14410, 7207, 196, 1727, 1923, 27, 919, 24816, 0, 9, 167, 265, 441, 4.3),
    "horse": Speeds(16843, 8431, 257, 2051, 2308, 22, 1248, 27454, 1, 14, 277, 329, 621, 3.7),
    "standing elephant": Speeds(79946, 39969, 5025, 11728, 16853, 13, 21268, 276489, 14, 9, 217, 2005, 2245, 7.5),
    "galloping elephant": Speeds(84638, 42321, 5135, 12395, 17530, 6, 35933, 215597, 15, 21, 447, 1716, 2199, 8.0),
    "armadillo": Speeds(331904, 165954, 77396, 58581, 135977, 11, 289830, 3188130, 62, 73, 1681, 9776, 11592, 11.7),
}

TABLE_2 = {
    "lion": Dimensions(44994, 22035, 2.0),
    "cat": Dimensions(64857, 27251, 2.4),
    "horse": Dimensions(75847, 34641, 2.2),
    "standing elephant": Dimensions(359751, 127441, 2.8),
    "galloping elephant": Dimensions(380883, 141217, 2.7),
    "armadillo": Dimensions(1493580, 541528, 2.8),
}

TABLE_3 = {
    ("cat", 5): Variant(0, 21, 267, 254, 542, 29140),
    ("cat", 9): Variant(0, 26, 571, 436, 1033, 34232),
    ("horse", 5): Variant(1, 87, 557, 308, 953, 37492),
    ("horse", 9): Variant(1, 91, 657, 410, 1159, 41280),
    ("galloping elephant", 5): Variant(9, 41, 834, 1909, 2793, 145713),
    ("galloping elephant", 9): Variant(9, 71, 1606, 2229, 3915, 153084),
    ("armadillo", 5): Variant(45, 497, 3309, 11603, 15454, 556309),
    ("armadillo", 9): Variant(51, 621, 7013, 15550, 23235, 575401),
}
"""By mesh and width of the joints; width 3 is Tables 1 and 2."""

TABLE_4 = {
    ("cat", 7, 6): Variant(0, 16, 154, 242, 412, 25153),
    ("cat", 30, 12): Variant(0, 54, 700, 421, 1175, 38610),
    ("horse", 7, 6): Variant(0, 23, 257, 293, 573, 30725),
    ("horse", 30, 20): Variant(0, 54, 631, 477, 1177, 41753),
    ("galloping elephant", 7, 6): Variant(13, 18, 368, 1878, 2277, 136655),
    ("galloping elephant", 18, 14): Variant(13, 37, 653, 1934, 2637, 144729),
    ("armadillo", 5, 4): Variant(64, 55, 966, 11215, 12300, 514868),
    ("armadillo", 14, 13): Variant(48, 131, 2512, 11373, 14064, 550432),
}
"""By mesh, number p of parts and number q of joints."""

FIGURE_15 = {"silhouettes": 323, "spanning-tree": 321, "manual": 375}
"""Time of an interpolation by segmentation."""


def edge_dimension(edges: int, vertices: int) -> int:
    """Return what Table 2 prints as the dimension of S_e: ``2 E + 3 V + 6`` gives all six of its numbers."""
    return 2 * edges + 3 * vertices + 6
