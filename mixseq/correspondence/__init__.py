"""Find which point of one mesh is which point of another.

`correspond` is the way in: it takes `markers`, pairs of vertices that a person has set, to a `dense` correspondence,
which everything else works with. `checks` refuses markers that cannot be meant as they are, and warns of those that do
not fit the others (`outliers`); `orientation` refuses meshes that are inside out. `registration` deforms the source
until it lies on the target (`energy`), `matching` finds closest points there and measures how good that is.
`map_completion` takes the maps that others have made. All work on a `triangle_mesh`. `suggestions` finds markers
to confirm: tips of limbs (`extremities` of a `coarse_surface`) that belong together (`extremity_matching`); `mirroring`
tells which point is which on a body's other side, and `examination` what markers are worth while they are set.
`decimation` thins out meshes for those, and for others who want to try on small ones.
"""
