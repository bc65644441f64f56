"""Runs a generator of interfaces, and keeps what it parsed for the next one: parsing takes most of the time of each.

Usage: parse_once.py GENERATOR ARGUMENTS..., in the folder of the build.
"""

import hashlib
import pathlib
import pickle
import runpy
import sys

from rosidl_parser import parser

KEPT = pathlib.Path("parsed")
PARSER = pathlib.Path(parser.__file__).read_bytes()
parse = parser.parse_idl_string


def parse_once(idl: str, png_file: str | None = None) -> object:
    kept = KEPT / hashlib.sha256(PARSER + idl.encode()).hexdigest()
    if not kept.exists():
        KEPT.mkdir(exist_ok=True)
        new = kept.with_suffix(".new")
        new.write_bytes(pickle.dumps(parse(idl, png_file)))
        new.replace(kept)
    return pickle.loads(kept.read_bytes())


parser.parse_idl_string = parse_once
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
