//! Whole lists, page by page.

use backlot_proto::v1;

use crate::connection::{Connection, with_deadline};
use crate::error::{Error, Result};

const PAGE_SIZE: i32 = 500;

/// Every drive log, in the server's order.
pub async fn drive_logs(connection: &Connection) -> Result<Vec<v1::DriveLogSummary>> {
    let mut all = Vec::new();
    let mut page_token = String::new();
    loop {
        let request = v1::ListDriveLogsRequest {
            page_size: PAGE_SIZE,
            page_token,
        };
        let reply = connection
            .drive_logs()
            .list_drive_logs(with_deadline(request))
            .await;
        let page = reply
            .map_err(Error::status("listing drive logs"))?
            .into_inner();
        all.extend(page.drive_logs);
        if page.next_page_token.is_empty() {
            return Ok(all);
        }
        page_token = page.next_page_token;
    }
}

/// Every job; of one drive log if its name is not empty.
pub async fn jobs(connection: &Connection, drive_log: &str) -> Result<Vec<v1::Job>> {
    let mut all = Vec::new();
    let mut page_token = String::new();
    loop {
        let request = v1::ListJobsRequest {
            page_size: PAGE_SIZE,
            page_token,
            drive_log: drive_log.to_owned(),
        };
        let reply = connection.jobs().list_jobs(with_deadline(request)).await;
        let page = reply.map_err(Error::status("listing jobs"))?.into_inner();
        all.extend(page.jobs);
        if page.next_page_token.is_empty() {
            return Ok(all);
        }
        page_token = page.next_page_token;
    }
}

/// Every asset of a kind (UNSPECIFIED: any) and source log (empty: any).
pub async fn assets(
    connection: &Connection,
    kind: v1::AssetKind,
    source_log: &str,
) -> Result<Vec<v1::Asset>> {
    let mut all = Vec::new();
    let mut page_token = String::new();
    loop {
        let request = v1::ListAssetsRequest {
            page_size: PAGE_SIZE,
            page_token,
            kind: kind.into(),
            source_log: source_log.to_owned(),
        };
        let reply = connection
            .assets()
            .list_assets(with_deadline(request))
            .await;
        let page = reply.map_err(Error::status("listing assets"))?.into_inner();
        all.extend(page.assets);
        if page.next_page_token.is_empty() {
            return Ok(all);
        }
        page_token = page.next_page_token;
    }
}
