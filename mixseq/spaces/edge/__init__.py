"""The space S_e of edge lengths and dihedral angles, and its projections."""

from mixseq.spaces.edge.edge_space import EdgeSettings, EdgeSpace

__all__ = ["EdgeSettings", "EdgeSpace"]
