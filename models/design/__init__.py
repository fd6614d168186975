"""The finger as a design: its nine parameters and their unit cube (`space`), drawing, prints and what can be printed.

`fin_ray` is the paper's family and draws its section, `finger` and `tray` make bodies and print trays of it, `sheet`
and `glyphs` the paper that goes with them, `printability` the rules that a printed finger keeps.
"""
