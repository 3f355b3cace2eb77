"""An extension of griffe: roles of Sphinx in docstrings become links to what the pages document."""

import re

import griffe

ROLE = re.compile(r":(?:class|mod|func|meth|data|attr|exc):`(~?)\.*([^`]+)`")
TABLE = re.compile(r"^=+  =+\n(.*?)^=+  =+$", re.M | re.S)


class Roles(griffe.Extension):
    """Rewrites the docstring of every object."""

    def on_instance(self, *, obj, **_):
        if obj.docstring is not None:
            obj.docstring.value = in_markdown(obj.docstring.value)


def in_markdown(text: str) -> str:
    """The text of a docstring with links for roles, and without tables of modules."""
    return ROLE.sub(link, TABLE.sub("", text)).replace("``", "`")


def link(role: re.Match) -> str:
    """A link, or plain code if no page documents the name."""
    name = role[2].rpartition(".")[2] if role[1] else role[2]
    return f'<autoref optional identifier="{role[2]}"><code>{name}</code></autoref>'
