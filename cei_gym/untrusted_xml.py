"""XML from strangers: no entities, no namespaces, bounded in size, depth and number of elements."""

import io
from xml.etree.ElementTree import Element, TreeBuilder
from xml.sax import SAXParseException
from xml.sax.handler import ContentHandler
from xml.sax.xmlreader import AttributesImpl

from defusedxml.common import DefusedXmlException
from defusedxml.sax import make_parser

from cei_gym.errors import CEIError, one_line

MAX_BYTES = 16_000_000
MAX_ELEMENTS = 200_000
MAX_DEPTH = 200


def load_xml(content: bytes, max_bytes: int = MAX_BYTES) -> Element:
    """The elements of a document, with tags and attributes as they are written.

    Prefixes stay part of a name, bound or not: as MuJoCo's parser reads them, so that nothing means one thing here and another there.

    Args:
        content: the document.
        max_bytes: how long it may be.

    Raises:
        CEIError: it is no XML, or has what is not allowed; without the file's name, which the caller knows.
    """
    if len(content) > max_bytes:
        raise CEIError(f"it has {len(content)} bytes; {max_bytes} are allowed")
    handler = _Tree()
    parser = make_parser()  # namespaces are off
    parser.setContentHandler(handler)
    try:
        parser.parse(io.BytesIO(content))
    except DefusedXmlException:
        raise CEIError("XML entities are not allowed") from None
    except SAXParseException as error:
        where = f"line {error.getLineNumber()}, column {error.getColumnNumber()}"
        raise CEIError(f"not well-formed XML: {one_line(error.getMessage())}: {where}") from None
    except (LookupError, ValueError) as error:  # of encodings
        if isinstance(error, CEIError):
            raise
        raise CEIError(f"not well-formed XML: {one_line(error)}") from None
    return handler.tree()


class _Tree(ContentHandler):
    """Builds the elements; gives up as soon as there are too many."""

    def __init__(self) -> None:
        super().__init__()
        self._builder = TreeBuilder()
        self._depth = self._elements = 0

    def startElement(self, name: str, attrs: AttributesImpl) -> None:
        self._depth += 1
        self._elements += 1
        if self._depth > MAX_DEPTH:
            raise CEIError(f"elements are nested more than {MAX_DEPTH} deep")
        if self._elements > MAX_ELEMENTS:
            raise CEIError(f"it has more than {MAX_ELEMENTS} elements")
        self._builder.start(name, dict(attrs))

    def endElement(self, name: str) -> None:
        self._depth -= 1
        self._builder.end(name)

    def characters(self, content: str) -> None:
        self._builder.data(content)

    def tree(self) -> Element:
        """The root, once the document is read."""
        return self._builder.close()
