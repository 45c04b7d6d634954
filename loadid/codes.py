"""Every guard code of the package, in words; how findings are collected, and which codes a user may allow."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from structures.errors import InputError
from structures.flags import Flag, canonical

GUARDS = {
    "E102": "a transfer matrix without any coupling",
    "E104": "a load at a support",
    "W105": "loads next to a support",
    "W106": "nodal forces shown as a pressure",
    "W107": "a load basis finer than the data can see",
    "W108": "plain bricks that lock",
    "E109": "plain bricks of a nearly incompressible material",
    "E110": "mesh counts that no mesh has",
    "W111": "a modulus that no elastomer has",
    "W112": "strains beyond the linear range",
    "W113": "rate independence taken for linearity, or the other way",
    "W114": "model checked against a known load",
    "W115": "too few elements through the thickness of a pad",
    "E116": "a structure that is a mechanism",
    "W201": "fewer sensors than loads, or rank loss",
    "W202": "conditioning that looks better because channels were lost",
    "W203": "noise correlated by interpolation",
    "W204": "sensors of different kinds without noise levels",
    "W205": "AC-coupled channels and a static load",
    "W206": "health of the channels",
    "W207": "causality of the FRF",
    "N207": "causality of an FRF that could not be tested",
    "W208": "kind of FRF and its units",
    "W209": "truncated file",
    "W210": "channels with more gaps than samples",
    "W211": "lines of an FRF that were not measured",
    "W212": "forces of a test that move together",
    "E212": "forces of a test that are one",
    "E213": "an offset that cannot be told from a constant load",
    "N303": "what regularisation did",
    "W304": "more detail than the data hold",
    "W305": "a gain of resolution promised by the wrong law",
    "E306": "a load that is not determined without regularisation",
    "W307": "a lambda that carries units",
    "W308": "constraints that fight the data",
    "E309": "side constraints that no load meets",
    "W310": "a lambda that biases even the resultant",
    "W311": "a prior that does not fit the load",
    "E312": "a record that holds nothing beyond its noise",
    "W401": "corner of the L-curve",
    "W402": "minimum of GCV",
    "W403": "correlated noise",
    "W404": "a rule that needs white noise",
    "W405": "too few data to test the noise",
    "W406": "source of the noise level",
    "W407": "agreement of the rules",
    "W409": "a lambda that changes per frame",
    "W410": "a solver stopped by its iteration cap",
    "E410": "a sparse problem that was not solved",
    "W411": "lambda at an end of its range",
    "W412": "a load that does not explain its data",
    "E501": "a load that drifts because no sensor sees its constant part",
    "W502": "variance of a tracked load that was not tuned",
    "W503": "state noise that is not balanced over the modes",
    "W504": "innovations that are larger than the filter says, or biased",
    "W505": "record shorter than the memory of the structure",
    "E506": "an impulse response without a usable diagonal",
    "W507": "antiresonances",
    "W508": "leakage, and windows that cut a signal",
    "W509": "modes above the Nyquist frequency",
    "W510": "a load class that the prior does not fit",
    "W511": "a place that the data leave open",
    "E512": "candidate places that leave the same data",
    "E513": "candidate places that are not regularised alike",
    "E514": "a load unknown in space and time that the sensors do not determine",
    "W516": "harmonic loads that the lines do not tell apart",
    "W517": "a constant load that no sensor sees and the penalty leaves free",
    "W518": "a record that starts in motion",
    "W519": "a constant load that only its prior holds",
    "W520": "a filter that takes a good part of the record to settle",
    "W521": "samples that the gate of a tracker keeps out",
    "W522": "a tracker that goes on with another model",
    "W523": "numbers of a prior that the record does not tell",
    "W524": "wrong samples in the record of a fit",
    "W525": "displacements that are believed, not measured",
    "W526": "an event of a tracked load far beyond the loads of the fit",
    "W527": "innovations in service whose mean is off: an offset",
    "W601": "a half-space formula on a pad that is not thick, or near its edge",
    "E602": "a half-space formula on a thin pad",
    "E603": "tangential motion from images without viewing angle and index",
    "W604": "markers that vanished, and frames that are missing",
    "W605": "marker noise correlated by interpolation",
    "N606": "motion that was completed, not tracked",
    "W607": "drift of a gel, or an old calibration",
    "W608": "regularisation that costs the resultant",
    "N610": "an output of resultants, not a map",
    "W611": "a camera or a gel that moved as a whole",
    "N701": "resultants alone were compared",
    "W702": "data simulated by the model that inverts them",
    "W703": "coverage of the band",
    "W704": "record used in making the model",
    "W705": "wrong gain or wrong shape of a gel",
    "W706": "a validation of another calibration",
}


def known_codes(codes: Iterable[str], *, where: str = "allow") -> tuple[str, ...]:
    """The codes in full form.

    Raises
    ------
    InputError
        If one of them is no code of the package; the message lists those that are.
    """
    full = []
    for code in codes:
        short = str(code).strip().upper().removeprefix("LID-")
        if short not in GUARDS:
            raise InputError(
                "there is no such guard code",
                where=where,
                found=repr(code),
                expected=f"one of {', '.join(GUARDS)}",
                hint="only refusals (E) can be overridden",
            )
        full.append(canonical(short))
    return tuple(full)


def collect(flags: Iterable[Flag | None]) -> tuple[Flag, ...]:
    """The flags that were raised, without repeats, in order."""
    seen: dict[tuple[str, str], Flag] = {}
    for flag in flags:
        if flag is not None:
            seen.setdefault((flag.code, flag.message), flag)
    return tuple(seen.values())


def allowed(codes: Sequence[str]) -> tuple[str, ...]:
    """Codes that a user allows, in full form.

    Raises
    ------
    InputError
        If one of them is no guard code.
    """
    if not isinstance(codes, list | tuple | set | frozenset):
        raise InputError("allow takes a list of codes", where="allow", found=repr(codes), expected=f"[{codes!r}]")
    return known_codes(codes)
