//! Pages of lists: sizes with limits and opaque tokens that are good for one list and filter only.

use tonic::Status;

use super::limits::{DEFAULT_PAGE, MAX_PAGE};
use super::status::invalid_field;

/// What to read for one page.
#[derive(Debug, PartialEq, Eq)]
pub(crate) struct Page {
    pub(crate) limit: usize,
    /// Id of the last item of the page before; "" for the first page.
    pub(crate) after: String,
    list: String,
}

impl Page {
    /// `list` names the list and its filters: a token made for another one is refused.
    pub(crate) fn parse(page_size: i32, token: &str, list: String) -> Result<Self, Status> {
        let limit = match usize::try_from(page_size) {
            Ok(0) => DEFAULT_PAGE,
            Ok(size) => size.min(MAX_PAGE),
            Err(_) => return Err(invalid_field("page_size", "is negative")),
        };
        let after = match token {
            "" => String::new(),
            token => open(token, &list)
                .ok_or_else(|| invalid_field("page_token", "was not made by this list"))?,
        };
        Ok(Self { limit, after, list })
    }

    /// Items to read: one more than shown tells whether there is a next page.
    pub(crate) fn read_limit(&self) -> usize {
        self.limit + 1
    }

    /// Cuts what was read to the page and makes the token of the next one, "" if there is none.
    pub(crate) fn close<T>(&self, items: &mut Vec<T>, id: impl Fn(&T) -> String) -> String {
        if items.len() <= self.limit {
            return String::new();
        }
        items.truncate(self.limit);
        items
            .last()
            .map_or_else(String::new, |last| seal(&id(last), &self.list))
    }
}

/// Hexadecimal of the id, then of the checksum over list and id.
fn seal(after: &str, list: &str) -> String {
    let mut token: String = after.bytes().map(|byte| format!("{byte:02x}")).collect();
    token.push_str(&format!("{:08x}", checksum(after, list)));
    token
}

fn open(token: &str, list: &str) -> Option<String> {
    if !token.is_ascii() {
        return None;
    }
    let (hex, crc) = token.split_at_checked(token.len().checked_sub(8)?)?;
    let bytes = hex
        .as_bytes()
        .chunks(2)
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok())
        .collect::<Option<Vec<u8>>>()?;
    let after = String::from_utf8(bytes).ok()?;
    let found = u32::from_str_radix(crc, 16).ok()?;
    (found == checksum(&after, list)).then_some(after)
}

fn checksum(after: &str, list: &str) -> u32 {
    crc32c::crc32c(format!("{list}\n{after}").as_bytes())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn page(size: i32, token: &str, list: &str) -> Result<Page, Status> {
        Page::parse(size, token, list.into())
    }

    #[test]
    fn pages_chain_and_the_last_has_no_token() {
        let all: Vec<String> = (0..5).map(|i| format!("id{i}")).collect();
        let mut seen = Vec::new();
        let mut token = String::new();
        loop {
            let page = page(2, &token, "jobs").unwrap();
            let later = all.iter().filter(|id| **id > page.after).cloned();
            let mut items: Vec<String> = later.take(page.read_limit()).collect();
            token = page.close(&mut items, String::clone);
            seen.extend(items);
            if token.is_empty() {
                break;
            }
        }
        assert_eq!(seen, all);
    }

    #[test]
    fn foreign_and_broken_tokens_are_refused() {
        let token = seal("id1", "jobs");
        assert_eq!(page(1, &token, "jobs").unwrap().after, "id1");
        assert!(page(1, &token, "jobs driveLogs/other").is_err());
        assert!(page(1, &token[1..], "jobs").is_err());
        assert!(page(-1, "", "jobs").is_err());
        assert_eq!(page(i32::MAX, "", "jobs").unwrap().limit, MAX_PAGE);
    }

    proptest! {
        #[test]
        fn hostile_tokens_do_not_panic(token in ".{0,40}") {
            let _ = page(1, &token, "jobs");
        }
    }
}
