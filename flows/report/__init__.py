"""The campaign report: one self-contained HTML folder with figures, their data and the SQL behind them."""
