//! A store in S3-compatible storage.
//!
//! Credentials, region and address come from the usual variables: `AWS_ACCESS_KEY_ID`, `AWS_SECRET_ACCESS_KEY`,
//! `AWS_REGION`, `AWS_ENDPOINT`, and `AWS_ALLOW_HTTP` for a server without TLS.

use std::{
    io::{self, Read},
    path::PathBuf,
    time::Duration,
};

use futures_util::TryStreamExt;
use object_store::{
    ObjectStore, ObjectStoreExt, PutPayload, RetryConfig,
    aws::{AmazonS3, AmazonS3Builder},
    path::Path,
};
use tokio::runtime::{Builder, Runtime};

use crate::files::{Files, found};

/// Bytes sent at once; S3 requires 5 MiB for each part except the last.
const PART: usize = 8 << 20;
/// Retries of a request to a busy server, and their total time.
const RETRIES: usize = 5;
const PATIENCE: Duration = Duration::from_secs(20);

/// Environment variables for the server's address.
const ENDPOINTS: [&str; 3] = ["AWS_ENDPOINT", "AWS_ENDPOINT_URL", "AWS_ENDPOINT_URL_S3"];

/// Objects below a prefix.
pub(crate) struct Bucket {
    objects: AmazonS3,
    prefix: Path,
    runtime: Runtime,
}

impl Bucket {
    /// `BUCKET` or `BUCKET/FOLDER`.
    pub(crate) fn new(address: &str) -> io::Result<Self> {
        let (bucket, folder) = address.split_once('/').unwrap_or((address, ""));
        if bucket.is_empty() {
            return Err(io::Error::other("it names no bucket"));
        }
        for variable in ENDPOINTS {
            let host = |address: &str| address.strip_prefix("http").map(|rest| rest.trim_start_matches('s').to_owned());
            let is_address = |address: &str| {
                host(address).is_some_and(|rest| {
                    rest.len() > 3 && rest.starts_with("://") && !rest.contains(char::is_whitespace)
                })
            };
            if std::env::var(variable).is_ok_and(|address| !is_address(&address)) {
                return Err(io::Error::other(format!("{variable} is not an address such as http://localhost:9000")));
            }
        }
        // Reject characters that would be escaped: others would then look under another name.
        let prefix = Path::parse(folder.trim_end_matches('/')).map_err(io::Error::other)?;
        if Path::from(prefix.as_ref()) != prefix {
            return Err(io::Error::other("the folder must be of plain letters, digits, -, _, . and /"));
        }
        let retry = RetryConfig { max_retries: RETRIES, retry_timeout: PATIENCE, ..RetryConfig::default() };
        let objects = AmazonS3Builder::from_env().with_bucket_name(bucket).with_retry(retry).build();
        Ok(Self {
            objects: objects.map_err(plain)?,
            prefix,
            runtime: Builder::new_current_thread().enable_all().build()?,
        })
    }

    /// Waits for the result of this work.
    fn wait<T>(&self, work: impl Future<Output = object_store::Result<T>>) -> io::Result<T> {
        self.runtime.block_on(work).map_err(plain)
    }

    fn path(&self, name: &str) -> Path {
        let parts = self.prefix.parts();
        parts.chain(Path::from(name).parts().map(|part| part.as_ref().to_owned().into())).collect()
    }
}

/// Reads the next part; a short one is the last.
fn part(from: &mut dyn Read) -> io::Result<Vec<u8>> {
    let mut bytes = Vec::new();
    from.take(PART as u64).read_to_end(&mut bytes)?;
    Ok(bytes)
}

impl Files for Bucket {
    fn put(&self, name: &str, from: &mut dyn Read) -> io::Result<()> {
        let path = self.path(name);
        let first = part(from)?;
        self.runtime.block_on(async {
            // A short part was read to its end, which is where a reader may fail.
            if first.len() < PART {
                return self.objects.put(&path, PutPayload::from(first)).await.map(drop).map_err(plain);
            }
            let mut upload = self.objects.put_multipart(&path).await.map_err(plain)?;
            let sent = async {
                let mut bytes = first;
                while !bytes.is_empty() {
                    let is_last = bytes.len() < PART;
                    upload.put_part(PutPayload::from(bytes)).await.map_err(plain)?;
                    bytes = if is_last { Vec::new() } else { part(from)? };
                }
                upload.complete().await.map(drop).map_err(plain)
            };
            let sent: io::Result<()> = sent.await;
            if sent.is_err() {
                // Parts left on the server cost money; nothing more can be done about a failure here.
                upload.abort().await.ok();
            }
            sent
        })
    }

    fn read(&self, name: &str, take: &mut dyn FnMut(&[u8]) -> io::Result<()>) -> io::Result<()> {
        self.runtime.block_on(async {
            let mut parts = self.objects.get(&self.path(name)).await.map_err(plain)?.into_stream();
            while let Some(part) = parts.try_next().await.map_err(plain)? {
                take(&part)?;
            }
            Ok(())
        })
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        let under = self.path(folder);
        let locations = self.objects.list(Some(&under)).map_ok(|object| object.location);
        let objects: Vec<Path> = self.wait(locations.try_collect())?;
        let named = |path: &Path| {
            let parts: Vec<_> = path.prefix_match(&self.prefix)?.map(|part| part.as_ref().to_owned()).collect();
            Some(parts.join("/"))
        };
        let mut names: Vec<String> = objects.iter().filter_map(named).collect();
        names.sort();
        Ok(names)
    }

    fn is_empty(&self) -> io::Result<bool> {
        Ok(self.wait(self.objects.list(Some(&self.prefix)).try_next())?.is_none())
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        found(self.wait(self.objects.delete(&self.path(name)))).map(drop)
    }

    fn remove_unfinished(&self) -> io::Result<()> {
        // Only the bucket's owner can see parts of an unfinished upload.
        Ok(())
    }

    fn file(&self, _name: &str) -> Option<PathBuf> {
        None
    }

    fn has(&self, name: &str) -> io::Result<bool> {
        Ok(found(self.wait(self.objects.head(&self.path(name))))?.is_some())
    }
}

/// In the form of a system error.
fn plain(error: object_store::Error) -> io::Error {
    let kind = match &error {
        object_store::Error::NotFound { .. } => io::ErrorKind::NotFound,
        object_store::Error::PermissionDenied { .. } | object_store::Error::Unauthenticated { .. } => {
            io::ErrorKind::PermissionDenied
        }
        _ => io::ErrorKind::Other,
    };
    io::Error::new(kind, error)
}
