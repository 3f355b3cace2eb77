"""The functions of the shells, and the form in which they take candidates."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterable
from typing import Final

# Attack: a participant announces names with which a shell would run commands once the user has
# pressed Enter. Candidates have no characters that a shell obeys, except for brackets of indexes.
_HARMLESS: Final = re.compile(r"[A-Za-z0-9_./:@%+=,\[\]-]+")

FUNCTIONS: Final = {
    "bash": """\
# Completion of uros in bash. In ~/.bashrc: eval "$(uros completion bash)"
_uros_complete() {
    local line
    COMPREPLY=()
    while IFS= read -r line; do
        COMPREPLY+=("$line")
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
    local -a found suffix
    found=("${(@f)$(${~words[1]} completion --next zsh -- \
"${(j: :)words[1,CURRENT]}" 2>/dev/null)}")
    if [[ -n "${found[1]}" ]]; then
        [[ ${#found} == 1 && ${found[1]} == *[/=] ]] && suffix=(-S '')
        _describe uros found "${suffix[@]}"
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
    else
        printf '%s\\n' $found
    end
end
complete -c uros -f -a '(__uros_complete)'
""",
}


def split(line: str) -> list[str]:
    """Return the words of a command line up to the cursor; the last one is being typed."""
    for end in ("", '"', "'"):
        try:
            words = shlex.split(line + end)
        except ValueError:
            continue
        return [*words, ""] if not end and line[-1:].isspace() else words or [""]
    return [""]


def lines(shell: str, word: str, candidates: Iterable[tuple[str, str]]) -> list[str]:
    """Return what the function of a shell reads.

    Args:
        shell: One of `FUNCTIONS`.
        word: The word that is being typed.
        candidates: Words that begin with it, each with a description or "".
    """
    harmless = [pair for pair in candidates if _HARMLESS.fullmatch(pair[0])]
    if shell == "bash":  # which splits words at these characters, and replaces the last part
        kept = max(word.rfind(":"), word.rfind("=")) + 1
        return [candidate[kept:] for candidate, _ in harmless]
    if shell == "zsh":
        return [
            f"{candidate.replace(':', chr(92) + ':')}:{about}" if about
            else candidate.replace(":", chr(92) + ":")
            for candidate, about in harmless
        ]  # fmt: skip
    return [f"{candidate}\t{about}" for candidate, about in harmless]
