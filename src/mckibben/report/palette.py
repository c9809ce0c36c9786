"""Colours of figures, of the local page and of animations; imports nothing."""

BLACK, ORANGE, SKY, GREEN = "#111111", "#E69F00", "#56B4E9", "#009E73"
BLUE, VERMILLION, PURPLE = "#0072B2", "#D55E00", "#CC79A7"
"""The colour-blind safe palette of Okabe and Ito."""
GREY, BAND = "#5F6B76", "#DBE2E9"
"""Colours of texts and lines in the background, and of ranges."""
MUSCLES, DESIRED, MEASURED = (BLUE, VERMILLION), BLACK, GREEN
PRESSURE, FORCE, CONTRACTION = PURPLE, GREEN, ORANGE
"""Colours of muscles 1 (antagonist) and 2 (agonist), of what is desired, and of what is measured or simulated;
those of quantities over time."""
