"""Output: result files, measurements, pictures, figures and the terminal."""
