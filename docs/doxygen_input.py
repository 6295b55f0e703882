# SPDX-License-Identifier: MIT
"""Prints a public header as Doxygen is to read it, which takes only comments of its own form.

A comment above functions or macros belongs to each of them, up to a blank line or another comment; in a struct or enum
it belongs to the next member. One behind a declaration belongs to all names in it. The first of a header, and one above
a blank line, belong to the file.
"""
import re
import sys

REST = r"(?:[^*]|\*(?!/))*\*/"  # of a comment
NAME = r"\*?\w+(?:\[\w+\])*"


def each_name(match):
    """A declaration of several members as one of each."""
    kind, names, note = match.groups()
    return "\n".join(f"  {kind}{name};{note or ''}" for name in names.split(", "))


def each_declaration(match):
    """The comment above some declarations above each of them that has none behind it."""
    note, first, others = match.groups()
    bare = r"^(?=(?:ERN_API|static inline|#define)(?![^\n]*/\*\*<))"
    return f"{note}\n{first}" + re.sub(bare, lambda _: f"{note}\n", others, flags=re.M)


with open(sys.argv[1], encoding="utf-8") as file:
    text = file.read()
text = re.sub(r"\A/\* SPDX.*\n \* ", "/** @file\n * ", text)
text = re.sub(rf"^/\* (?!----)({REST}\n)(?=\n)", r"/** @file\n * \1", text, flags=re.M)
text = re.sub(r"^( *[^\s/*][^\n]*?)/\*(?!\*)", r"\1/**<", text, flags=re.M)
text = re.sub(r"^( *)/\*(?!\*| ----)", r"\1/**", text, flags=re.M)
text = re.sub(rf"^  ((?:const )?\w+ )({NAME}(?:, {NAME})+);( */\*\*<{REST})?", each_name, text, flags=re.M)
text = re.sub(rf"^(/\*\*(?!<| @file){REST})\n([^\n]+\n)((?:(?!/\*|typedef|\}} )[^\n]+\n)*)", each_declaration, text,
              flags=re.M)
sys.stdout.write(text)
