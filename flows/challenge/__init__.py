"""The challenge: worlds that hide what is missing in the simulator, answers to them, and how answers are graded.

`world_folder`, `bank_table`: what an entrant gets. `answers`: what an entrant gives. `keys`, `make`: how worlds are
made and sealed. `grade`: the table. `hidden`: the laws, which no search imports.
"""
