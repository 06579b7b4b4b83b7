"""Pages in words that a run's folder holds, as HTML."""

from jinja2.utils import markupsafe
from markdown_it import MarkdownIt

OUTERMOST = 3
"""The level of a page's own title; above it are the report and its sections."""

# Text is data: no tags, and nothing that would reach for a network.
_MARKDOWN = MarkdownIt("commonmark", {"html": False}).enable("table")
_MARKDOWN.disable(["image", "link", "autolink", "reference"])


def markdown_html(text: str) -> markupsafe.Markup:
    """Markdown with tables as HTML; tags, links and pictures in it stay the text that they are.

    >>> print(markdown_html("# *A* & <b>").strip())
    <h3><em>A</em> &amp; &lt;b&gt;</h3>
    """
    tokens = _MARKDOWN.parse(text)
    for token in tokens:
        if token.type in ("heading_open", "heading_close"):
            token.tag = f"h{min(6, int(token.tag[1]) + OUTERMOST - 1)}"
    return markupsafe.Markup(_MARKDOWN.renderer.render(tokens, _MARKDOWN.options, {}))
