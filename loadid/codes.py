"""Every guard code of the package, in words."""

from structures._flags import allowed as allowed
from structures._flags import collect as collect
from structures._flags import explained as explained
from structures._flags import known_codes as known_codes
from structures._flags import table

__all__ = ["GUARDS"]

GUARDS = {code: guard.title for code, guard in table().items()}
