"""Letters that can be read from three metres: five by seven dots, two columns and one row each."""

from __future__ import annotations

DOT = "##"
LETTER_WIDTH = 12
ROWS = 7

# Five columns of each letter, the lowest bit on top: the shapes of common dot-matrix displays.
_COLUMNS = {
    "+": "08083e0808", "-": "0808080808", "?": "0201590906", ".": "0060600000",
    "0": "3e5149453e", "1": "00427f4000", "2": "7249494946", "3": "2141494d33", "4": "1814127f10",
    "5": "2745454539", "6": "3c4a494931", "7": "4121110907", "8": "3649494936", "9": "464949291e",
    "A": "7c1211127c", "B": "7f49494936", "C": "3e41414122", "D": "7f4141413e", "E": "7f49494941",
    "F": "7f09090901", "G": "3e41415173", "H": "7f0808087f", "I": "00417f4100", "J": "2040413f01",
    "K": "7f08142241", "L": "7f40404040", "M": "7f021c027f", "N": "7f0408107f", "O": "3e4141413e",
    "P": "7f09090906", "Q": "3e4151215e", "R": "7f09192946", "S": "2649494932", "T": "03017f0103",
    "U": "3f4040403f", "V": "1f2040201f", "W": "3f4038403f", "X": "6314081463", "Y": "0304780403",
    "Z": "6159494d43",
}  # fmt: skip


def big_lines(text: str, width: int) -> list[str]:
    """Return a word in big letters, cut off at the width; what has no shape is a space.

    Parameters
    ----------
    text : str
    width : int
        Characters of the screen.
    """
    letters = text.upper()[: width // LETTER_WIDTH]
    columns = [bytes.fromhex(_COLUMNS.get(letter, "0000000000")) + b"\0" for letter in letters]
    dots = b"".join(columns)
    blank = " " * len(DOT)
    return ["".join(DOT if column >> row & 1 else blank for column in dots).rstrip() for row in range(ROWS)]
