"""The place of colours before `mixseq.scene`; for one more version."""

from mixseq.renamed import moved

__getattr__ = moved(__name__, Colouring="mixseq.scene:Colouring", colourings_of="mixseq.scene:colourings_of")
