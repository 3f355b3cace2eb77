"""The functions of the shells, and the form in which they take candidates."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable
from typing import Final

# Attack: a participant announces names with which a shell would run commands once the user has
# pressed Enter. Candidates have no characters that a shell obeys, except for brackets of indexes.
_HARMLESS: Final = re.compile(r"[A-Za-z0-9_./:@%+=,\[\]-]+")
# Values in braces, which stand in quotes.
_HARMLESS_IN_QUOTES: Final = re.compile(r"\{[A-Za-z0-9_./:@%+=,\[\]{}' -]*\}")
# The candidate that keeps a shell from completing names of files, where there is no other one.
NO_FILES: Final = (" ", "")

FUNCTIONS: Final = {
    "bash": """\
# Completion of uros in bash. In ~/.bashrc: eval "$(uros completion bash)"
_uros_complete() {
    local line
    COMPREPLY=()
    while IFS= read -r line; do
        if [[ $line == " " ]]; then
            compopt +o bashdefault +o default
        else
            COMPREPLY+=("$line")
        fi
    done < <("${1/#\\~/$HOME}" completion --next bash -- "${COMP_LINE:0:COMP_POINT}" 2>/dev/null)
    if [[ ${#COMPREPLY[@]} == 1 && ${COMPREPLY[0]} == *[/=] ]]; then
        compopt -o nospace
    fi
}
complete -o bashdefault -o default -F _uros_complete uros
""",
    "zsh": """\
#compdef uros
# Completion of uros in zsh. In ~/.zshrc, behind compinit: eval "$(uros completion zsh)"
_uros_complete() {
    local -a found how
    found=("${(@f)$(${~words[1]} completion --next zsh -- \
"${(j: :)words[1,CURRENT]}" 2>/dev/null)}")
    if [[ "${found[1]}" == " " ]]; then
        return 1
    elif [[ -n "${found[1]}" ]]; then
        [[ ${#found} == 1 && ${found[1]} == *[/=] ]] && how=(-S '')
        [[ ${found[1]} == \\"* ]] && how=(-Q)
        _describe uros found "${how[@]}"
    else
        _files
    fi
}
(( $+functions[compdef] )) || { autoload -Uz compinit && compinit }
compdef _uros_complete uros
""",
    "fish": """\
# Completion of uros in fish. In ~/.config/fish/config.fish: uros completion fish | source
function __uros_complete
    set -l found (uros completion --next fish -- (commandline -cp) 2>/dev/null)
    if test (count $found) -eq 0
        __fish_complete_path (commandline -ct)
    else if test "$found" != " "
        printf '%s\\n' $found
    end
end
complete -c uros -f -a '(__uros_complete)'
""",
}


def split(line: str) -> list[str]:
    """Return the words of a command line up to the cursor; the last one is being typed."""
    return _split(line)[0]


def open_quote(line: str) -> str:
    """Return the quote that the last word of a command line is in, or nothing."""
    return _split(line)[1]


def _split(line: str) -> tuple[list[str], str]:
    for end in ("", '"', "'"):
        try:
            words = shlex.split(line + end)
        except ValueError:
            continue
        return [*words, ""] if not end and line[-1:].isspace() else words or [""], end
    return [""], ""


def lines(shell: str, word: str, quote: str, candidates: Iterable[tuple[str, str]]) -> list[str]:
    """Return what the function of a shell reads.

    Args:
        shell: One of `FUNCTIONS`.
        word: The word that is being typed.
        quote: The quote that it is in, or "".
        candidates: Words that begin with it, each with a description or "", and `NO_FILES`.
    """
    candidates = list(candidates)
    harmless = [
        pair
        for pair in candidates
        if _HARMLESS.fullmatch(pair[0]) or _HARMLESS_IN_QUOTES.fullmatch(pair[0])
    ]
    if shell == "zsh" and word.startswith("{") and not quote:
        harmless = []  # zsh replaces only what is behind such a brace
    if not harmless:
        return [NO_FILES[0]] if NO_FILES in candidates else []
    if shell == "bash":
        return [_for_bash(candidate, word, quote) for candidate, _ in harmless]
    if shell == "zsh":
        return [_for_zsh(candidate, quote, about) for candidate, about in harmless]
    return [f"{candidate}\t{about}" for candidate, about in harmless]


def _for_bash(candidate: str, word: str, quote: str) -> str:
    """Return a candidate as bash inserts it, without quoting any of it."""
    if quote == "'":
        return candidate.replace("''", '""')  # an empty string is the same in YAML
    if quote:
        return candidate
    if candidate.startswith("{"):
        return f'"{candidate}"'
    # Bash splits words at these characters, and replaces the last part.
    return candidate[max(word.rfind(":"), word.rfind("=")) + 1 :]


def _for_zsh(candidate: str, quote: str, about: str) -> str:
    """Return a candidate as `_describe` takes it; zsh quotes what does not begin with a quote."""
    if candidate.startswith("{") and not quote:
        candidate = f'"{candidate}"'
    candidate = candidate.replace(":", r"\:")
    return f"{candidate}:{about}" if about else candidate
