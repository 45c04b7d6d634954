"""Many structures, many hours: a plan of assets and records, worked on by processes or by a cluster.

What is done is decided by what is there: a chunk is its key, the digest of everything that its answer depends on, and
its answer is a file of that name. A run makes the parts that are missing, in any order and on any machine, and reads
the tables and the page from the parts alone.
"""
