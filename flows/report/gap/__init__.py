"""The page of a gap search: `page` writes it, from `figures` and the answer in words (`answer`)."""
