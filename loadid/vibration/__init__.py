"""The vibration laboratory: specifications, spectral targets, drives under limits, transfer paths in place."""

from ._completion import buzz, by_buzz, by_coherence, nearest, split_record
from ._drives import Drives as Drives
from ._finding import find_drives
from ._paths import TransferPaths as TransferPaths
from ._paths import VirtualPoint, transfer_paths
from ._profiles import Limit, Profile, Target

__all__ = [
    "Limit", "Profile", "Target", "VirtualPoint", "buzz", "by_buzz", "by_coherence", "find_drives", "nearest",
    "split_record", "transfer_paths",
]  # fmt: skip
