//! A run file as text in rows and cells, which damages change.

use std::fmt::Write;

/// A section of a run file.
#[derive(Clone)]
pub struct Section {
    pub name: String,
    pub columns: Vec<String>,
    pub rows: Vec<Vec<String>>,
}

/// A run file.
#[derive(Clone)]
pub struct Text {
    head: String,
    pub sections: Vec<Section>,
}

impl Text {
    pub fn of(text: &str) -> Self {
        let (mut head, mut sections) = (String::new(), Vec::<Section>::new());
        for line in text.lines().filter(|l| *l != "@END") {
            let cells = || line.split(',').map(str::to_owned).collect();
            match (line.strip_prefix('@'), sections.last_mut()) {
                (Some(name), _) => sections.push(Section { name: name.to_owned(), columns: Vec::new(), rows: Vec::new() }),
                (None, None) => head.push_str(&format!("{line}\n")),
                (None, Some(section)) if section.columns.is_empty() => section.columns = cells(),
                (None, Some(section)) => section.rows.push(cells()),
            }
        }
        Self { head, sections }
    }

    pub fn text(&self) -> String {
        let mut text = self.head.clone();
        for Section { name, columns, rows } in &self.sections {
            let _ = writeln!(text, "@{name}\n{}", columns.join(","));
            rows.iter().for_each(|row| text.push_str(&format!("{}\n", row.join(","))));
        }
        text.push_str("@END\n");
        text
    }

    pub fn section(&mut self, name: &str) -> Option<&mut Section> {
        self.sections.iter_mut().find(|s| s.name == name)
    }

    /// Another value of a key of the head.
    pub fn set(&mut self, key: &str, value: &str) {
        let lines = self.head.lines().map(|line| match line.split_once(" = ") {
            Some((name, _)) if name == key => format!("{key} = {value}\n"),
            _ => format!("{line}\n"),
        });
        self.head = lines.collect();
    }
}

impl Section {
    pub fn place(&self, column: &str) -> Option<usize> {
        self.columns.iter().position(|c| c == column)
    }

    /// Changes the numbers of some columns of every row together; the first argument is the index of the row. Empty cells stay.
    pub fn change<const N: usize>(&mut self, columns: [&str; N], change: impl Fn(usize, [f64; N]) -> [f64; N]) -> bool {
        let places = columns.map(|c| self.place(c));
        if places.iter().any(Option::is_none) {
            return false;
        }
        let places = places.map(Option::unwrap_or_default);
        for (index, row) in self.rows.iter_mut().enumerate() {
            let Ok(numbers) = places.iter().map(|p| row[*p].parse()).collect::<Result<Vec<f64>, _>>() else { continue };
            let changed = change(index, std::array::from_fn(|i| numbers[i]));
            for ((place, new), old) in places.iter().zip(changed).zip(numbers) {
                if new != old {
                    row[*place] = format!("{new}");
                }
            }
        }
        true
    }
}

impl Text {
    /// A table without a head.
    pub fn plain(table: Section) -> Self {
        Self { head: String::new(), sections: vec![table] }
    }

    /// The first section as a table.
    pub fn csv(&self) -> String {
        let lines = self.sections.first().into_iter().flat_map(|s| std::iter::once(&s.columns).chain(&s.rows));
        lines.map(|row| row.join(",") + "\n").collect()
    }
}
