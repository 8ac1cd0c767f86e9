"""Find which point of one mesh corresponds to which point of another.

`correspond` is the entry point, from `markers`, pairs of vertices set by a person, to a `dense` correspondence.
`checks` refuses invalid markers, and warns of `outliers`; `orientation` refuses meshes that are inside out.
`registration` deforms the source onto the target (`energy`), `matching` finds closest points there and measures the
result. `map_completion` completes given maps. All work on a `triangle_mesh`. `suggestions` proposes markers: tips of
limbs (`extremities` of a `coarse_surface`), matched by `extremity_matching`; `mirroring` finds points on a body's other
side, and `examination` rates markers while they are set. `decimation` thins out meshes for those.
"""
