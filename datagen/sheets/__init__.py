"""Everything that is drawn or printed: pages, their PNG, SVG and PDF, sets, pads, photos."""
