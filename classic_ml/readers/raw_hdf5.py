"""Raw records as HDF5: datasets of one length in one group, or a table of compound rows."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from classic_ml.readers.hdf5_claims import MOST_TEXTS, attributes_of, check_texts
from classic_ml.readers.hdf5_heaps import GuardedFile
from classic_ml.readers.raw_columns import as_columns, one_line
from classic_ml.readers.raw_table import RawFile, cannot_be_read
from classic_ml.readers.raw_tree import Leaf, Node, Tree, Unreadable, vectors
from classic_ml.readers.test_description import FileLayout
from surge_core.errors import InputError

__all__ = ["UNIT_ATTRIBUTES", "Walk", "hdf5_columns", "open_hdf5", "opened_hdf5", "unit_of"]

# More than any logger writes; links can make so many of two groups that nobody sees the end.
MOST_ITEMS = 20_000
DEEPEST = 100

UNIT_ATTRIBUTES = ("units", "unit", "unit_string", "engineering_units", "engineeringunits")
_COLUMN_ATTRIBUTES = ("columns", "column_names", "channel_names", "channels", "names")
# Deflate reaches 1032 to 1.
_MOST_COMPRESSED = 100_000

_OTHER_FILE = "a link to another file"
# What h5py and numpy raise where they stumble over what a file claims to be.
_SPOILED = (
    *(ArithmeticError, AttributeError, LookupError, OSError, RuntimeError),
    *(TypeError, ValueError),
)

# Takes a dataset or group and says what it is, or None where it is what it looks like.
Decoder = Callable[[Any, "Walk"], "Node | None"]


def open_hdf5(file: Path, layout: FileLayout) -> RawFile:
    """Open an HDF5 file; its rows are read slice by slice, links to other files are not followed.

    Parameters
    ----------
    file : path
        An existing file. A dataset is a column, and so is a field of a compound dataset; a matrix
        is a table where an attribute ``columns`` or a dataset of as many texts beside it names
        its columns. The attribute ``units`` states a unit.
    layout : FileLayout
        The group to take.

    Returns
    -------
    RawFile
        The columns of one length.

    Raises
    ------
    InputError
        When the file is spoiled, or it is open which group is meant.
    """
    return hdf5_columns(file, layout, "an HDF5 file")


def hdf5_columns(
    file: Path, layout: FileLayout, what: str, decoder: Decoder = lambda *_: None
) -> RawFile:
    """Open an HDF5 file whose datasets may mean more than HDF5 says.

    Parameters
    ----------
    file : path
        The file.
    layout : FileLayout
        The group to take.
    what : str
        What the file is called in an error.
    decoder : callable
        Takes a dataset or group and the walk that came by it; returns what it is, or None where
        it is what it looks like.
    """
    with opened_hdf5(file, what) as handle:
        try:
            found, aside = vectors(Walk(handle, str(file), decoder).tree(handle))
        except InputError:
            raise
        except (OSError, RuntimeError, KeyError, ValueError) as error:
            raise InputError(str(file), expected=what, found=one_line(error)) from None
    return as_columns(str(file), found, layout, lambda: opened_hdf5(file, what), aside)


@contextmanager
def opened_hdf5(file: Path, what: str) -> Iterator[Any]:
    """Open an HDF5 file for reading, or refuse it in one sentence."""
    import h5py

    with ExitStack() as opened:
        try:
            # The library's own driver asks whether anybody is writing into the file.
            plain = opened.enter_context(h5py.File(file, "r"))
            _, size_of_lengths = plain.id.get_create_plist().get_sizes()
            guarded = opened.enter_context(GuardedFile(file, size_of_lengths))
            handle = opened.enter_context(h5py.File(guarded, "r"))
        except OSError as error:
            raise cannot_be_read(file, what, one_line(error)) from None
        yield handle


class Walk:
    """A walk through an open HDF5 file: it comes to an end, whatever in the file leads to what.

    Parameters
    ----------
    handle : h5py.File
        The file.
    source : str
        What to call it in an error.
    decoder : callable
        As for :func:`hdf5_columns`.
    """

    def __init__(self, handle: Any, source: str, decoder: Decoder) -> None:
        import h5py

        self._source = source
        self._decoder = decoder
        self._file_number = h5py.h5o.get_info(handle.id).fileno
        self._above: list[int] = []
        self._visits_left = MOST_ITEMS

    def tree(self, group: Any) -> Tree:
        """Return a group as a tree, without reading the numbers."""
        tree: Tree = {}
        for name in group:
            if isinstance(name, bytes):
                # h5py takes such a name for no argument.
                tree[name.decode("utf-8", "replace")] = Unreadable("a name that is not UTF-8")
                continue
            node = self._guarded(partial(self._linked, group, name))
            # A group may hold itself.
            if node is not None:
                tree[name] = node
        return tree

    def referred(self, file: Any, reference: Any) -> Node:
        """Return what a reference leads to."""
        self.count()
        if not reference:
            return Unreadable("nothing in it")
        node = self._guarded(lambda: self._node(file[reference]))
        return Unreadable("a group that holds itself") if node is None else node

    def count(self, visits: int = 1) -> None:
        """Take note of visits, and refuse the file where there are too many."""
        self._visits_left -= visits
        if self._visits_left < 0:
            raise InputError(
                self._source,
                expected=f"at most {MOST_ITEMS:,} groups, datasets and references",
                found="more",
                remedy="do its links lead to the same group in many ways?",
            )

    def _guarded(self, look: Callable[[], Node | None]) -> Node | None:
        """Return one item, or why it cannot be read: the others may be good."""
        try:
            return look()
        except InputError:
            raise
        except _SPOILED as error:
            return Unreadable(f"what cannot be read ({one_line(error)})")

    def _linked(self, group: Any, name: str) -> Node | None:
        import h5py

        self.count()
        link = group.get(name, getlink=True)
        if isinstance(link, h5py.ExternalLink) or _leads_out(group, link):
            return Unreadable(_OTHER_FILE)
        try:
            item = group[name]
        except KeyError:
            return Unreadable("a link that leads nowhere")
        return self._node(item)

    def _node(self, item: Any) -> Node | None:
        """Return one item; None where it is a group that it lies in itself."""
        import h5py

        info = h5py.h5o.get_info(item.id)
        if info.fileno != self._file_number:
            # A soft link may lead through one to another file.
            return Unreadable(_OTHER_FILE)
        if info.addr in self._above:
            return None
        if len(self._above) == DEEPEST:
            return Unreadable(f"more than {DEEPEST} groups within one another")
        self._above.append(info.addr)
        try:
            return self._decoded(item)
        finally:
            self._above.pop()

    def _decoded(self, item: Any) -> Node:
        import h5py

        why_not = _without_values(item)
        if why_not:
            return Unreadable(why_not)
        if isinstance(item, h5py.Dataset):
            check_texts(Path(self._source), item)
        decoded = self._decoder(item, self)
        if decoded is not None:
            return decoded
        if isinstance(item, h5py.Group):
            return self.tree(item)
        if not isinstance(item, h5py.Dataset) or item.shape is None:
            return Unreadable("nothing in it")
        return _dataset(item)


def _leads_out(group: Any, link: Any) -> bool:
    """Return whether a soft link leads through one to another file."""
    import h5py

    if not isinstance(link, h5py.SoftLink):
        return False
    names = link.path.split("/")
    start = group if names[0] else group.file
    ways = ("/".join(names[:n]) for n in range(1, len(names)))
    return any(isinstance(start.get(way, getlink=True), h5py.ExternalLink) for way in ways if way)


def _without_values(item: Any) -> str:
    """Return why the values of a dataset are not its own; empty where they are."""
    import h5py

    if not isinstance(item, h5py.Dataset):
        return ""
    if item.external:
        return "values that lie in another file"
    if item.is_virtual:
        return "a view of other datasets without values of its own"
    # It claims far more rows than anybody wrote, and they would all be read.
    unwritten = item.size and item.nbytes > _MOST_COMPRESSED * item.id.get_storage_size()
    return "rows that were never written" if unwritten else ""


def _dataset(item: Any) -> Node:
    import h5py

    path = item.name
    if item.dtype.names is not None:
        return {field: _field(item, field) for field in item.dtype.names}
    if h5py.check_string_dtype(item.dtype) is not None:
        return _texts(item)
    if item.dtype.kind not in "iufb" or h5py.check_ref_dtype(item.dtype) is not None:
        return Unreadable("no real numbers")
    attributes = attributes_of(item, UNIT_ATTRIBUTES + _COLUMN_ATTRIBUTES)
    return Leaf(
        item.shape,
        lambda handle, index: np.asarray(handle[path][index]),
        unit_of(attributes),
        _attribute_texts(attributes, _COLUMN_ATTRIBUTES),
    )


def _field(table: Any, field: str) -> Leaf | Unreadable:
    """Return one field of a compound dataset."""
    path, dtype = table.name, table.dtype[field]
    if dtype.kind not in "iufb" or dtype.shape:
        return Unreadable("no real number in each row")
    return Leaf(table.shape, lambda handle, index: np.asarray(handle[path].fields(field)[index]))


def _texts(item: Any) -> str | list[str] | Unreadable:
    if item.size > MOST_TEXTS:
        return Unreadable("texts")
    values = np.atleast_1d(item.asstr(errors="replace")[()]).ravel()
    return [str(value) for value in values] if item.shape else str(values[0])


def unit_of(attributes: Mapping[str, Any]) -> str:
    """Return the unit among the attributes of a dataset; empty without."""
    return next(iter(_attribute_texts(attributes, UNIT_ATTRIBUTES)), "")


def _attribute_texts(attributes: Mapping[str, Any], names: tuple[str, ...]) -> tuple[str, ...]:
    """Return the texts of the first attribute of one of some names, in any case of letters."""
    import h5py

    by_name = {str(key).lower(): key for key in attributes}
    for name in names:
        if name in by_name:
            stated = attributes[by_name[name]]
            if stated is None or isinstance(stated, h5py.Empty):
                continue
            values = np.atleast_1d(np.asarray(stated, dtype=object)).ravel()
            return tuple(
                value.decode("utf-8", "replace") if isinstance(value, bytes) else str(value)
                for value in values
            )
    return ()
