"""Solution: time steps, their size, TS and SNES, spectra, and the linearised step."""
