"""The page of the lab that walks through the gel pad: a rendered press, step by step."""
