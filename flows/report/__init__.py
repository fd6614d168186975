"""Reports: a folder of HTML, figures, data and the SQL behind them, of a campaign, a calibration or a gap search.

A page's Python computes what its template (`*.html.j2`, beside it) shows. `page.html.j2`, `parts.html.j2`, `page.css`,
`folder` and `style` are what all pages share; `grasp_frames` is what pictures and Rerun recordings of a grasp draw
from; `mesh_picture` draws solid bodies.
"""
