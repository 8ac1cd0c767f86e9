"""Which point of one mesh is which point of another.

`markers` are pairs of vertices that a person has set, `dense` is the whole map that all others work with. `correspond`
makes one of the other: `checks` asks whether the markers can be meant as they are (`suspects`, `sides`, `thin_plate`:
which of them do not fit the others; `orientation`: which mesh is inside out), `pairing` which components belong
together, `registration` bends the source onto the target (`similarity`, `energy`, `fitting`), `matching` finds closest
points there, `quality` measures them. `given` makes maps of those that others have made (`completing` what these
leave out).
"""
