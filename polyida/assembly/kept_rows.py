"""The rows of phi that are equations in a mode of a scene, and those of friction that slip, taken from the Links of all rows.

Points and vectors stay those of all rows, so that their numbers do not change.
"""

import numpy as np

from polyida.assembly.arrays import Slips, concatenated, starts


def kept_rows(links, rows):
    """{name: field} of the fields of Links that describe the rows, for these rows, (k,) int, in their order."""
    number = np.full(len(links.row_constant), -1)
    number[rows] = np.arange(len(rows))
    shifts, products = number[links.shift_row] >= 0, number[links.product_row] >= 0
    entries = [np.arange(links.row_start[row], links.row_start[row + 1]) for row in rows]
    listed = concatenated(entries, np.int64)
    kept = {name: getattr(links, name)[shifts] for name in links._fields if name.startswith("shift_")}
    kept |= {name: getattr(links, name)[products] for name in links._fields if name.startswith("product_")}
    return kept | {
        "row_constant": links.row_constant[rows],
        "row_start": starts(entries),
        "row_columns": links.row_columns[listed],
        "row_slopes": links.row_slopes[listed],
        "shift_row": number[kept["shift_row"]],
        "product_row": number[kept["product_row"]],
        "velocity_rows": np.sort(number[links.velocity_rows][number[links.velocity_rows] >= 0]),
    }


def slips_of(links, rows, constant, mu, on_contact, on):
    """The Slips of the rows of friction with these numbers, (k,) int; on: for each the numbers of the equations that press it."""
    fields = links._asdict() | kept_rows(links, rows)
    return Slips(
        **{name: fields[name] for name in Slips._fields if name in fields},
        constant=np.asarray(constant, float),
        mu=np.asarray(mu, float),
        on_contact=np.asarray(on_contact, np.bool_),
        on_start=starts(on),
        on=concatenated(on, np.int64),
    )


def no_slips(links):
    """The Slips of a scene in which nothing slips."""
    none = np.zeros(0, np.int64)
    return slips_of(links, none, none, none, none, [])
