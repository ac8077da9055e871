import pytest

from polyida.show.styles import unicode_number


@pytest.mark.parametrize(
    ("formula", "text"),
    [
        (r"$\mathdefault{0.25}$", "0.25"),
        (r"$\mathdefault{−1.5}$", "−1.5"),
        (r"$\mathdefault{10^{-12}}$", "10⁻¹²"),
        (r"$\mathdefault{-10^{3}}$", "−10³"),
        (r"$\mathdefault{2\times10^{-5}}$", "2×10⁻⁵"),
        (r"$\times\mathdefault{10^{−3}}\mathdefault{+1}$", "×10⁻³+1"),
        ("as it is", "as it is"),
        ("", ""),
    ],
)
def test_formulas_become_letters(formula, text):
    assert unicode_number(formula) == text
