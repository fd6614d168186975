"""The page of a calibration: `page` writes it from `sections`, `data` reads it, two files draw its figures."""
