"""Templates: what is put in is text, and a name that is not filled in is a mistake."""

import pytest
from jinja2 import UndefinedError
from markupsafe import Markup

from robosim.analysis.report.markup import backticks_as_code, code, rendered


def test_code_is_text_within_tags():
    assert code("<b>&") == Markup("<code>&lt;b&gt;&amp;</code>")


def test_backticks_are_code_and_the_rest_is_text():
    assert backticks_as_code("`a` < `<b>`.") == Markup("<code>a</code> &lt; <code>&lt;b&gt;</code>.")


def test_a_page_with_a_name_that_is_not_filled_in_is_refused():
    with pytest.raises(UndefinedError):
        rendered("page.html", title="only this")
