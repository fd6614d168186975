"""Files of testing machines: whatever program wrote them, whatever stands above and below the samples.

`cells` makes grids of texts of a file, `numbers` reads the marks of numbers, `words` knows what columns and units are
called, `head` finds the samples and their columns, `format` is the file in which a person says it, `channels` gives the
numbers in s, mm and N, `split` finds the pulls, `pulls` gives the grasps, `guess` writes a format file from an example.
"""
