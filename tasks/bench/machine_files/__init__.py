"""Files of testing machines: whatever program wrote them, whatever stands above and below the samples.

`cells` makes a grid of texts of a file, `numbers` reads the marks of numbers, `head` finds the columns and their units,
`words` knows what columns are called, `format` is the file in which a person says it, `guess` writes that file from an
example, `pulls` gives the grasps.
"""
