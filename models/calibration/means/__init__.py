"""Calibration on mean pull-off forces (Kennedy and O'Hagan; Eq. 9 to 12 of the FAST paper).

`calibrate.calibrate` takes a `problem`. phi are the parameters of the emulator, psi those of the measurements with
theta (`parameters`). `factorised` finds the mode (`emulator`, `joint`), samples psi there (`psi_density`, cheap as a
`theta_surrogate`, along the `ridge`) and weighs the draws (`reweight`); `joint` samples everything, exactly. `predict`
says what follows for designs, `checks` how far that can be trusted.
"""
