//! The footer of a Parquet file, looked through before it is decoded.
//!
//! The decoder of polars asks for the memory of as many elements as a list says that it has before it has read one, and a count
//! that damage has made would end the program. A list cannot have more elements than bytes are left, since each takes one at
//! least. The walk goes through the footer as the decoder does, by the numbers of the fields (`parquet.thrift` of the Apache
//! Parquet format) and, where those are unknown, by the types that the file states (Thrift compact protocol).

use std::io::{Read, Seek, SeekFrom};

/// Bytes behind the footer: its length and the mark of the format.
const TAIL: i64 = 8;
/// How deep structures of unknown fields may lie in each other.
const DEEPEST: usize = 64;

/// What the decoder reads in a field.
enum Shape {
    /// A number of one to ten bytes.
    Number,
    /// One byte.
    Byte,
    /// A truth value, which is in the head of its field.
    Flag,
    /// A length and as many bytes.
    Text,
    List(&'static Shape),
    Struct(Fields),
}

/// The fields of a structure by their number in the format.
type Fields = &'static [(i16, Shape)];

use Shape::{Byte, Flag, List, Number, Struct, Text};

const EMPTY: Shape = Struct(&[]);
const UNIT: Shape = Struct(&[(1, EMPTY), (2, EMPTY), (3, EMPTY)]);
const TIME: Shape = Struct(&[(1, Flag), (2, UNIT)]);
const LOGICAL_TYPE: Shape = Struct(&[
    (1, EMPTY),
    (2, EMPTY),
    (3, EMPTY),
    (4, EMPTY),
    (5, Struct(&[(1, Number), (2, Number)])),
    (6, EMPTY),
    (7, TIME),
    (8, TIME),
    (10, Struct(&[(1, Byte), (2, Flag)])),
    (11, EMPTY),
    (12, EMPTY),
    (13, EMPTY),
    (14, EMPTY),
    (15, EMPTY),
]);
const SCHEMA_ELEMENT: Shape = Struct(&[
    (1, Number),
    (2, Number),
    (3, Number),
    (4, Text),
    (5, Number),
    (6, Number),
    (7, Number),
    (8, Number),
    (9, Number),
    (10, LOGICAL_TYPE),
]);
const STATISTICS: Shape = Struct(&[(1, Text), (2, Text), (3, Number), (4, Number), (5, Text), (6, Text), (7, Flag), (8, Flag)]);
const COLUMN: Shape = Struct(&[
    (1, Number),
    (2, List(&Number)),
    (3, List(&Text)),
    (4, Number),
    (5, Number),
    (6, Number),
    (7, Number),
    (9, Number),
    (10, Number),
    (11, Number),
    (12, STATISTICS),
    (14, Number),
    (15, Number),
]);
const COLUMN_CHUNK: Shape = Struct(&[(1, Text), (2, Number), (3, COLUMN), (4, Number), (5, Number), (6, Number), (7, Number)]);
const SORTING_COLUMN: Shape = Struct(&[(1, Number), (2, Flag), (3, Flag)]);
const ROW_GROUP: Shape = Struct(&[
    (1, List(&COLUMN_CHUNK)),
    (2, Number),
    (3, Number),
    (4, List(&SORTING_COLUMN)),
    (5, Number),
    (6, Number),
    (7, Number),
]);
const KEY_VALUE: Shape = Struct(&[(1, Text), (2, Text)]);
const COLUMN_ORDER: Shape = Struct(&[(1, EMPTY), (2, EMPTY)]);
const FILE: Shape = Struct(&[
    (1, Number),
    (2, List(&SCHEMA_ELEMENT)),
    (3, Number),
    (4, List(&ROW_GROUP)),
    (5, List(&KEY_VALUE)),
    (6, Text),
    (7, List(&COLUMN_ORDER)),
]);

/// Whether no list of the footer has more elements than bytes are left. The place in the file is as before.
///
/// # Errors
/// Why the file cannot be read.
pub(super) fn lists_fit(file: &mut (impl Read + Seek)) -> std::io::Result<bool> {
    let place = file.stream_position()?;
    let size = file.seek(SeekFrom::End(0))?;
    let mut footer = Vec::new();
    if size >= TAIL.unsigned_abs() {
        file.seek(SeekFrom::End(-TAIL))?;
        let mut length = [0; 4];
        file.read_exact(&mut length)?;
        let length = u64::from(u32::from_le_bytes(length)).min(size - TAIL.unsigned_abs());
        file.seek(SeekFrom::Start(size - TAIL.unsigned_abs() - length))?;
        // The decoder may read into the eight bytes behind the footer.
        file.take(length + TAIL.unsigned_abs()).read_to_end(&mut footer)?;
    }
    file.seek(SeekFrom::Start(place))?;
    Ok(Walk { rest: &footer }.through(&FILE).is_some())
}

/// A way through a footer. Its steps give `None` where the footer ends too early or says what the decoder refuses.
struct Walk<'a> {
    rest: &'a [u8],
}

impl Walk<'_> {
    fn byte(&mut self) -> Option<u8> {
        let (first, rest) = self.rest.split_first()?;
        self.rest = rest;
        Some(*first)
    }

    fn pass(&mut self, count: u64) -> Option<()> {
        self.rest = self.rest.get(usize::try_from(count).ok()?..)?;
        Some(())
    }

    /// A number in groups of seven bits, the lowest first; what is beyond 64 bits counts as the largest number.
    fn number(&mut self) -> Option<u64> {
        let (mut value, mut shift) = (0_u64, 0_u32);
        loop {
            let byte = self.byte()?;
            let group = u64::from(byte & 0x7F);
            value = if shift < 63 { value | (group << shift) } else { u64::MAX };
            shift += 7;
            if byte & 0x80 == 0 {
                return Some(value);
            }
        }
    }

    /// The type of the elements of a list and their count.
    fn list(&mut self) -> Option<(u8, u64)> {
        let head = self.byte()?;
        let count = if head >> 4 == 15 { self.number()? } else { u64::from(head >> 4) };
        (count <= self.rest.len() as u64).then_some((head & 0xF, count))
    }

    /// The head of a field: its type and its number; `None` in it at the end of the structure.
    fn field(&mut self, last: i16) -> Option<Option<(u8, i16)>> {
        let head = self.byte()?;
        let (stated, step) = (head & 0xF, i16::from(head >> 4));
        if stated == 0 {
            return Some(None);
        }
        // Numbers of fields are written with the sign in the lowest bit, and cut to 16 bits by the decoder.
        let full = |coded: u64| ((coded >> 1) as i64 ^ -((coded & 1) as i64)) as i16;
        let number = if step == 0 { full(self.number()?) } else { last.checked_add(step)? };
        Some(Some((stated, number)))
    }

    fn through(&mut self, shape: &Shape) -> Option<()> {
        match shape {
            Number => self.number().map(drop),
            Byte => self.byte().map(drop),
            Flag => Some(()),
            Text => {
                let length = self.number()?;
                self.pass(length)
            }
            List(element) => {
                let (_, count) = self.list()?;
                (0..count).try_for_each(|_| self.through(element))
            }
            Struct(fields) => {
                let mut last = 0;
                while let Some((stated, number)) = self.field(last)? {
                    match fields.iter().find(|(known, _)| *known == number) {
                        Some((_, shape)) => self.through(shape)?,
                        None => self.unknown(stated, DEEPEST)?,
                    }
                    last = number;
                }
                Some(())
            }
        }
    }

    /// A field that the decoder does not know, by the type that the file states.
    fn unknown(&mut self, stated: u8, depth: usize) -> Option<()> {
        let depth = depth.checked_sub(1)?;
        match stated {
            1 | 2 => Some(()),
            3 => self.byte().map(drop),
            4..=6 => self.number().map(drop),
            7 => self.pass(8),
            8 => self.through(&Text),
            9 => {
                let (element, count) = self.list()?;
                (0..count).try_for_each(|_| self.unknown(element, depth))
            }
            12 => {
                let mut last = 0;
                while let Some((stated, number)) = self.field(last)? {
                    self.unknown(stated, depth)?;
                    last = number;
                }
                Some(())
            }
            _ => None,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::lists_fit;
    use crate::files::import::Format;
    use crate::files::table::columns;
    use crate::files::table::{Table, Values};
    use std::io::Cursor;

    /// A file that has this footer and nothing else.
    fn with_footer(footer: &[u8]) -> Cursor<Vec<u8>> {
        let mut bytes = b"PAR1".to_vec();
        bytes.extend_from_slice(footer);
        bytes.extend_from_slice(&u32::try_from(footer.len()).unwrap().to_le_bytes());
        bytes.extend_from_slice(b"PAR1");
        Cursor::new(bytes)
    }

    #[test]
    fn a_list_of_more_elements_than_bytes_is_refused_wherever_it_is() {
        // Thrift compact: the head of a field has the step of its number in the high and its type in the low half.
        let whole: &[u8] = &[0x15, 2, 0x19, 0x0C, 0x16, 0, 0x19, 0x0C, 0];
        assert!(lists_fit(&mut with_footer(whole)).unwrap());
        // The schema (field 2) of 268 million elements; the same where the file states that the field is a number.
        for stated in [0x19, 0x15] {
            let endless = [0x15, 2, stated, 0xFC, 0xFF, 0xFF, 0xFF, 0x7F, 0x16, 0, 0x19, 0x0C, 0];
            assert!(!lists_fit(&mut with_footer(&endless)).unwrap(), "{stated}");
        }
        // A list of truth values in a field that nobody knows, number 100, which takes no bytes but time.
        let unknown = [0x15, 2, 0x09, 200, 1, 0xF1, 0xFF, 0xFF, 0xFF, 0x7F, 0];
        assert!(!lists_fit(&mut with_footer(&unknown)).unwrap());
        // Groups of rows (field 4) whose first has a sorting (field 4) of 268 million columns.
        let inner = [0x15, 2, 0x19, 0x0C, 0x16, 0, 0x19, 0x1C, 0x49, 0xFC, 0xFF, 0xFF, 0xFF, 0x7F, 0, 0];
        assert!(!lists_fit(&mut with_footer(&inner)).unwrap());
    }

    #[test]
    fn a_whole_table_passes_and_is_not_moved() {
        let mut table = Table::default();
        table.push("run", Values::Text(vec!["a".to_owned(), "b".to_owned()]));
        table.push("b_nt", Values::Numbers(vec![0.1, f64::NAN]));
        let mut file = Cursor::new(table.parquet().unwrap());
        file.set_position(3);
        assert!(lists_fit(&mut file).unwrap());
        assert_eq!(file.position(), 3);
    }

    #[test]
    fn the_file_that_ended_the_program_is_refused_by_name() {
        // Found by fuzzing: a list of the footer asks for 39 GB.
        let bytes = include_bytes!("../../../fuzz/seeds/auxiliary/endless_list.parquet");
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("calm.parquet");
        std::fs::write(&path, &bytes[1..]).unwrap();
        let told = columns::read(&path, Format::Parquet).err().unwrap().to_string();
        assert!(told.contains("calm.parquet") && told.contains("take it from the archive again"), "{told}");
    }
}
