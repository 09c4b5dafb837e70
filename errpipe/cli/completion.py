"""`errpipe completion`."""

from __future__ import annotations

import sys
from typing import Literal

import typer

BASH = """\
_errpipe() {{
    local word="${{COMP_WORDS[COMP_CWORD]}}" words=""
    if [ "$COMP_CWORD" -eq 1 ]; then
        words="{verbs}"
    elif [ "${{word:0:1}}" = "-" ]; then
        case "${{COMP_WORDS[1]}}" in
{cases}
        esac
    fi
    COMPREPLY=($(compgen -W "$words" -- "$word"))
    if [ -z "$words" ]; then COMPREPLY=($(compgen -f -- "$word")); fi
}}
complete -o filenames -F _errpipe errpipe
"""


def command(shell: Literal["bash", "zsh", "fish"] = typer.Argument(help="The shell.")) -> None:
    """Print the shell code that completes verbs and options.

    \b
    Put one of these into the shell's start-up file:
      bash  source <(errpipe completion bash)
      zsh   source <(errpipe completion zsh)
      fish  errpipe completion fish | source

    \b
    Example:
      errpipe completion bash
    """
    from errpipe.cli._names import VERBS
    from errpipe.cli._verbs import verb

    options = {name: sorted({o for p in verb(name).params for o in p.opts if o.startswith("--")}) for name in VERBS}
    if shell == "fish":
        lines = ["complete -c errpipe -f -n __fish_use_subcommand -a '" + " ".join(VERBS) + "'"]
        for name, flags in options.items():
            seen = f"-n '__fish_seen_subcommand_from {name}'"
            lines += [f"complete -c errpipe {seen} -l {option.removeprefix('--')}" for option in flags]
        sys.stdout.write("\n".join([*lines, ""]))
        return
    head = "autoload -U +X bashcompinit && bashcompinit\n" if shell == "zsh" else ""
    cases = "\n".join(f'            {name}) words="{" ".join(flags)}" ;;' for name, flags in options.items())
    sys.stdout.write(head + BASH.format(verbs=" ".join(VERBS), cases=cases))
