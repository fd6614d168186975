"""Which designs to try next: candidate points of the mixed design space and the value of evaluating them."""
