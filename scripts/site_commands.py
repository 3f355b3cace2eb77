"""The pages of the commands, made from the parsers of the command line."""

import argparse
import os
import re
from importlib import import_module

from uros.tools import cli

WIDTH = "88"  # columns of a usage; wider lines scroll on the page


def nav() -> list:
    """The entries of nav: the overview, and a page for each command or group of commands."""
    names = cli._ROOT.members
    return ["commands/README.md", *[{f"uros {name}": f"commands/{name}.md"} for name in names]]


def pages() -> dict:
    """The Markdown text of each page, by its path on the site."""
    os.environ["COLUMNS"] = WIDTH
    made = {"commands/README.md": overview()}
    for name, member in cli._ROOT.members.items():
        title = f"# `uros {name}`\n\n{sentence(member.help)}\n\n"
        made[f"commands/{name}.md"] = title + member_text(f"uros {name}", member)
    return made


def overview() -> str:
    lines = [
        "# Commands",
        "",
        "These pages are made from the parsers of the command line: they list what"
        " `uros COMMAND --help` prints. [Tools](../tools.md) and [the agent](../agent.md) describe"
        " what the commands do.",
        "",
        "| command | what it does |",
        "| --- | --- |",
    ]
    for name, member in cli._ROOT.members.items():
        lines.append(f"| [`uros {name}`]({name}.md) | {escaped(member.help)} |")
    return "\n".join(lines) + "\n"


def member_text(words: str, member) -> str:
    """The text below the heading of a command, or of a group with its commands."""
    if isinstance(member, cli.Group):
        parts = [
            f"## `{words} {name}`\n\n{sentence(verb.help)}\n\n"
            + member_text(f"{words} {name}", verb)
            for name, verb in member.members.items()
        ]
        return "\n".join(parts)
    parser = argparse.ArgumentParser(prog=words)
    import_module(f"uros.tools.{member.module}").add_arguments(parser)
    return parser_text(parser)


def parser_text(parser: argparse.ArgumentParser) -> str:
    subparsers = [a for a in parser._actions if isinstance(a, argparse._SubParsersAction)]
    text = usage(parser)
    text += arguments(action for action in parser._actions if action not in subparsers)
    if parser.epilog:
        text += f"```text\n{parser.epilog.strip()}\n```\n\n"
    for choices in subparsers:
        text += subcommands(choices)
    return text


def subcommands(choices: argparse._SubParsersAction) -> str:
    """The subcommands, with the options that most of them share listed once."""
    help_of = {action.dest: action.help for action in choices._choices_actions}
    by_name = {
        name: {identity(action): action for action in parser._actions}
        for name, parser in choices.choices.items()
    }
    often = [key for actions in by_name.values() for key in actions]
    shared = {key for key in often if often.count(key) > len(by_name) / 2}
    text = ""
    for name, actions in by_name.items():
        text += f"## `{choices.choices[name].prog}`\n\n{sentence(help_of[name] or '')}\n\n"
        if not shared <= set(actions):
            text += usage(choices.choices[name])
        text += arguments(action for key, action in actions.items() if key not in shared)
    first = next(actions for actions in by_name.values() if shared <= set(actions))
    text += "## Options of all transports\n\n" if shared else ""
    return text + arguments(action for key, action in first.items() if key in shared)


def identity(action: argparse.Action) -> tuple:
    return (*action.option_strings, action.dest, action.help)


def usage(parser: argparse.ArgumentParser) -> str:
    return f"```text\n{parser.format_usage().strip()}\n```\n\n"


def arguments(actions) -> str:
    """A definition list of arguments and options."""
    text = ""
    for action in actions:
        if action.help is argparse.SUPPRESS or isinstance(action, argparse._HelpAction):
            continue
        text += f"{term(action)}\n:   {sentence(explained(action))}\n\n"
    return text


def term(action: argparse.Action) -> str:
    values = argparse.HelpFormatter("uros")
    if not action.option_strings:
        metavar = action.metavar if isinstance(action.metavar, str) else action.dest
        return f"`{metavar}`"
    value = ""
    if action.nargs != 0:
        value = " " + values._format_args(action, values._get_default_metavar_for_optional(action))
    return ", ".join(f"`{name}{value}`" for name in action.option_strings)


def explained(action: argparse.Action) -> str:
    """The help of an argument, with its choices if the term does not show them."""
    text = (action.help or "") % dict(vars(action), prog="uros")
    hidden = action.choices is not None and action.metavar is not None
    missing = [
        str(c) for c in action.choices or () if not re.search(rf"\b{re.escape(str(c))}\b", text)
    ]
    return text + (f" (one of {', '.join(map(str, action.choices))})" if hidden and missing else "")


def sentence(text: str) -> str:
    """A help text as a sentence of a page."""
    text = escaped(" ".join(text.split()))
    return text[:1].upper() + text[1:] + ("" if text.endswith((".", ":")) else ".")


def escaped(text: str) -> str:
    """A help text in which nothing is Markdown; options and names in capitals are code."""
    text = re.sub(r"([\\`*_<>|\[\]])", r"\\\1", text)
    return re.sub(r"(?<![\w-])--[a-z][a-z0-9-]*", lambda option: f"`{option[0]}`", text)
