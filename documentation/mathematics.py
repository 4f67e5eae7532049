"""An MkDocs hook that converts formulas to MathML, which browsers render without scripts."""

import html
import re

from latex2mathml.converter import convert

_FORMULA = re.compile(r'<(span|div) class="arithmatex">\\[(\[](.*?)\\[)\]]</\1>', re.DOTALL)


def on_page_content(content: str, **_: object) -> str:
    r"""Replace every formula of a page.

    >>> on_page_content('<span class="arithmatex">\\(x\\)</span>')  # doctest: +ELLIPSIS
    '<math ...display="inline"><mrow><mi>x</mi></mrow></math>'
    """
    return _FORMULA.sub(_mathml, content)


def _mathml(formula: re.Match[str]) -> str:
    display = "inline" if formula[1] == "span" else "block"
    return convert(html.unescape(formula[2].strip()), display=display)
