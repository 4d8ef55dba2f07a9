"""The recipes by which source policies are made (`benchmark.source_policies`): what their policies are called."""

from pathlib import Path

from benchmark.settings.setting import check_choice

USUAL = "robust"

RECIPES = {
    USUAL: "demonstrations most of which were disturbed on purpose, the paper's from undisturbed ones",
    "clean": "1,000 undisturbed demonstrations alone, like the paper's",
}
"""What the policies of each learned from."""


def check_recipe(recipe: str) -> None:
    """Refuse a recipe that is not there.

    Raises:
        SettingError: If it is not allowed.
    """
    check_choice("recipe", recipe, RECIPES)


def policy_name(recipe: str, seed: int | str, rank: int | str) -> str:
    """Name of a policy: seed42-1 of the usual recipe, clean-seed42-1 of the other one of that name."""
    return f"{'' if recipe == USUAL else f'{recipe}-'}seed{seed}-{rank}"


def recipe_folder(folder: Path, recipe: str) -> Path:
    """Where documents on a recipe's policies go: those on the usual one's to the folder itself."""
    return folder if recipe == USUAL else folder / recipe
