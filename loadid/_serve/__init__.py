"""Many live structures in one process: a tracker for each, samples from files, sockets and brokers.

What comes from a source that cannot be asked again (a message that is confirmed, a socket) is on the disk before it is
tracked (`journal`); it is confirmed after its answers are in their tables. A checkpoint of a structure says how far it
has come; a run that goes on makes what lies behind it again, from the journal, the file or the offset, and finds the
rows that stand there already.
"""
