"""Runs a generator of interfaces, and keeps what it parsed: interfaces for the next one, templates for the next interface.

To parse both again and again takes most of the time. Usage: parse_once.py GENERATOR ARGUMENTS..., in the folder of the build.
"""

import hashlib
import pathlib
import pickle
import re
import runpy
import sys
from functools import cache
from typing import Any

import em
from rosidl_parser import parser

KEPT = pathlib.Path("parsed")
PARSER = pathlib.Path(parser.__file__).read_bytes()
parse = parser.parse_idl_string
COMMENT = re.compile(r'@verbatim \(language="comment", text=.*?"\)\s*\n', re.DOTALL)
"""Two thirds of what there is to parse, of which nothing comes but comments in C."""


def parse_once(idl: str, png_file: str | None = None) -> object:
    kept = KEPT / hashlib.sha256(PARSER + idl.encode()).hexdigest()
    if not kept.exists():
        KEPT.mkdir(exist_ok=True)
        new = kept.with_suffix(".new")
        new.write_bytes(pickle.dumps(parse(COMMENT.sub("", idl), png_file)))
        new.replace(kept)
    return pickle.loads(kept.read_bytes())


@cache
def tokens_of(prefix: str, template: str) -> list[Any]:
    whole = template if template.endswith("\n") else f"{template}{prefix}\n"  # markup may need what follows it
    return [*iter(em.Scanner(prefix, whole).one, None)]


def run_template(interpreter: Any, template: str, name: str = "<string>", locals: dict[str, Any] | None = None) -> None:
    """`em.Interpreter.string` of empy 3.3, for which a template is scanned once."""
    interpreter.contexts.push(em.Context(name))
    for token in tokens_of(interpreter.prefix, template):
        token.run(interpreter, locals)
    interpreter.contexts.pop()


compiled = cache(compile)
parser.parse_idl_string = parse_once
if em.__version__.startswith("3.3."):
    em.Interpreter.string = run_template
    em.eval = lambda expression, *names: eval(compiled(expression.lstrip(), "<template>", "eval"), *names)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
