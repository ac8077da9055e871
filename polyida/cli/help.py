"""The help: commands in groups, examples as they are typed."""

from typer.core import TyperGroup

FIRST = "Flexible multibody dynamics with polygonal finite elements."
COMPUTE, LOOK, STUDY = "Compute", "Look at a run", "Studies and names"
LONGEST = 120  # characters of what the list says of a command
GROUPS = (COMPUTE, LOOK, STUDY)
START = {
    "polyida compare double-plate": "three integrators on one scene: a table and a report",
    "polyida compare double-plate --cells 400": "the same, finer",
    "polyida run my_scene.py:build": "a scene of yours, in my_scene.py: `def build(): ... return scene`",
    "polyida list": "what has a name",
    "polyida COMMAND --help": "more on each",
}


class Groups(TyperGroup):
    """The commands, each in its group."""

    def format_commands(self, ctx, formatter):
        """A section of each group in place of one of all commands."""
        for group in GROUPS:
            commands = [self.commands[name] for name in self.list_commands(ctx) if self.commands[name].rich_help_panel == group]
            with formatter.section(group):
                formatter.write_dl([(command.name, command.get_short_help_str(LONGEST)) for command in commands])


def examples(lines: dict[str, str]) -> str:
    """What stands at the end of a command's help: {what is typed: what it does}, each on lines of its own, which are not wrapped."""
    return "\b\nExamples:\n" + "\n".join(f"  {typed}\n      {what}" for typed, what in lines.items())
