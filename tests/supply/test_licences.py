"""Whoever installs warpvox may use, change and sell what comes with it: the licences of all that it depends on."""

import re
from email.message import Message
from fnmatch import fnmatch
from importlib.metadata import distribution

from closure import extras_of, installed_closure, required

# Permissive licences, by SPDX identifier and by the names that metadata older than SPDX expressions use.
ALLOWED = {
    "0BSD", "Apache-2.0", "Apache-2.0 WITH LLVM-exception", "BSD-2-Clause", "BSD-3-Clause", "BSL-1.0", "CC0-1.0",
    "HPND", "ISC", "MIT", "MIT-CMU", "PSF-2.0", "Unlicense", "Zlib", "3-Clause BSD License", "Apache 2.0",
    "Apache License 2.0", "Apache License, Version 2.0", "Apache Software License", "BSD", "BSD License",
    "MIT License", "Python Software Foundation License",
}  # fmt: skip
WEAK = "asks only that changes to its own files stay open; we change none"
NVIDIA = "part of torch's CUDA builds only, free to use and to pass on with a program; nobody needs it to run on a CPU"
# pattern of names -> (what the metadata say, why it may stay)
EXCEPTIONS = {
    "certifi": ("Mozilla Public License 2.0 (MPL 2.0)", WEAK),
    "hypothesis": ("MPL-2.0", WEAK),
    "pathspec": ("Mozilla Public License 2.0 (MPL 2.0)", WEAK),
    "tqdm": ("MPL-2.0 AND MIT", WEAK),
    "neat-python": ("Copyright (c) 2007-2011, cesar.gomes and mirrorballu2", "the text of BSD-3-Clause, not its name"),
    "usd-core": ("LicenseRef-TOST-1.0", "Apache-2.0 with another clause on trademarks (Pixar's licence of OpenUSD)"),
    "nvidia-*": ("*", NVIDIA),
    "cuda-*": ("*", NVIDIA),
}


def licence(metadata: Message) -> str:
    """The licence as the metadata say it: an SPDX expression, else classifiers, else the first line of a text."""
    expression = metadata.get("License-Expression")
    if expression:
        return str(expression)
    classifiers = [text.split(" :: ")[-1] for text in metadata.get_all("Classifier") or () if "License ::" in text]
    if classifiers:
        return " AND ".join(sorted(classifiers))
    return str(metadata.get("License") or "").strip().split("\n")[0]


def allowed(said: str) -> bool:
    """Whether every licence of an expression is allowed; also those behind OR, so that nobody has to choose."""
    if said in ALLOWED:
        return True
    parts = [part.strip(" ()") for part in re.split(r"\s(?:AND|OR)\s", said)]
    return all(part in ALLOWED for part in parts)


def excepted(name: str, said: str) -> bool:
    return any(fnmatch(name, pattern) and fnmatch(said, text) for pattern, (text, _) in EXCEPTIONS.items())


def test_every_dependency_has_an_allowed_licence() -> None:
    closure = installed_closure("warpvox", extras_of("warpvox"))
    asked = {one.name.lower() for one in required(distribution("warpvox"), set())}
    assert asked <= set(closure), "the closure is taken from metadata: reinstall warpvox"
    said = {name: licence(found.metadata) for name, found in sorted(closure.items())}
    refused = {name: text for name, text in said.items() if not allowed(text) and not excepted(name, text)}
    assert not refused, f"neither an allowed licence nor an exception with a reason: {refused}"


def test_no_exception_is_idle() -> None:
    closure = installed_closure("warpvox", extras_of("warpvox"))
    for pattern, (_, reason) in EXCEPTIONS.items():
        assert len(reason) > 20
        for name, found in closure.items():
            if fnmatch(name, pattern) and "*" not in pattern:
                assert not allowed(licence(found.metadata)), f"{name} needs no exception any more"
