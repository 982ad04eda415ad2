//! Protects the page: rejects requests that a page of another site has made, and restricts what this page may do.
use axum::http::{
    header::{self, HeaderName, HeaderValue},
    HeaderMap, Uri,
};

use crate::hosts::Hosts;

/// The rules for requests, and for what the page may do.
#[derive(Clone, Debug)]
pub struct Guard {
    hosts: Hosts,
    policy: HeaderValue,
    is_tls: bool,
}

impl Guard {
    /// Creates the guard. `names`: host names in addition to this computer's. `embedded_in`: the sites whose pages may contain this
    /// one in a frame.
    ///
    /// # Errors
    /// Fails if a site is not the origin of a page.
    pub fn new(names: &[String], embedded_in: &[String], is_tls: bool) -> Result<Self, String> {
        for site in embedded_in {
            let uri = site.parse::<Uri>().ok();
            let is_origin = uri.is_some_and(|uri| {
                uri.scheme().is_some() && uri.authority().is_some() && uri.path() == "/"
            });
            if !is_origin || site.contains([';', ',', ' ']) {
                return Err(format!(
                    "{site:?} is not the origin of a page, such as https://example.org"
                ));
            }
        }
        let parents = match embedded_in {
            [] => "'none'".to_owned(),
            sites => sites.join(" "),
        };
        let policy = format!(
            "default-src 'none'; script-src 'self'; style-src 'self'; connect-src 'self'; img-src 'self' blob: data:; \
             form-action 'self'; base-uri 'none'; frame-ancestors {parents}"
        );
        Ok(Self {
            hosts: Hosts::new(names),
            policy: policy
                .parse()
                .map_err(|_| "an origin contains a character that is not allowed")?,
            is_tls,
        })
    }

    /// Returns whether the request is for this program. A page of another site can make its own name point to this computer, and
    /// would then be allowed to read the answers.
    pub fn accepts_host(&self, headers: &HeaderMap) -> bool {
        text(headers, &header::HOST).is_some_and(|host| self.hosts.accepts(host))
    }

    /// Returns whether a page of this program has made the request.
    pub fn accepts_origin(&self, headers: &HeaderMap) -> bool {
        let origin = text(headers, &header::ORIGIN);
        let host = text(headers, &header::HOST);
        let (Some(origin), Some(host)) = (origin, host) else {
            return false;
        };
        let scheme = if self.is_tls { "https://" } else { "http://" };
        origin.strip_prefix(scheme) == Some(host)
    }

    /// Returns the headers of every answer.
    pub fn headers(&self) -> [(HeaderName, HeaderValue); 4] {
        let fixed = HeaderValue::from_static;
        [
            (header::CONTENT_SECURITY_POLICY, self.policy.clone()),
            (header::X_CONTENT_TYPE_OPTIONS, fixed("nosniff")),
            (header::REFERRER_POLICY, fixed("same-origin")),
            (
                HeaderName::from_static("cross-origin-resource-policy"),
                fixed("same-origin"),
            ),
        ]
    }
}

fn text<'a>(headers: &'a HeaderMap, name: &HeaderName) -> Option<&'a str> {
    headers.get(name)?.to_str().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn guard() -> Guard {
        Guard::new(&[], &[], false).expect("valid")
    }

    fn headers(host: &str, origin: &str) -> HeaderMap {
        let mut headers = HeaderMap::new();
        headers.insert(header::HOST, host.parse().expect("header"));
        headers.insert(header::ORIGIN, origin.parse().expect("header"));
        headers
    }

    #[test]
    fn only_own_pages_are_accepted() {
        let accepts = |host, origin| guard().accepts_origin(&headers(host, origin));
        assert!(accepts("localhost:8080", "http://localhost:8080"));
        for origin in [
            "http://evil.example",
            "http://localhost:9090",
            "https://localhost:8080",
            "null",
            "",
        ] {
            assert!(!accepts("localhost:8080", origin), "{origin}");
        }
    }

    #[test]
    fn sites_that_may_embed_the_page_are_origins() {
        let embedded = |site: &str| Guard::new(&[], &[site.to_owned()], false);
        let guard = embedded("https://example.org").expect("an origin");
        let policy = guard.policy.to_str().expect("text");
        assert!(
            policy.ends_with("frame-ancestors https://example.org"),
            "{policy}"
        );
        for site in [
            "example.org",
            "https://example.org/page",
            "*",
            "https://a; script-src *",
        ] {
            assert!(embedded(site).is_err(), "{site}");
        }
    }
}
