// Format frame numbers as mixseq/sequence/frame_rates.py does.
"use strict";

var mixseqFrame = (number) => String(Number(number.toFixed(Math.abs(number - Math.round(number)) < 1e-3 ? 0 : 3))).replace("-", "\u2212");
