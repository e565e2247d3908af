//! Replays `tests/vectors/schema.json`, the golden vectors of schema texts.

use serde_json::Value;
use sm2_proto::schema::Schema;

const VECTORS: &str = include_str!("../../tests/vectors/schema.json");

//= SM2-TYP-001, SM2-TYP-002 test
#[test]
fn every_text_is_read_or_refused_as_its_vector_says() {
    let vectors: Vec<Value> = serde_json::from_str(VECTORS).unwrap();
    assert!(vectors.iter().any(|it| it["hash"].is_null()));
    for vector in vectors {
        let text = vector["text"].as_str().unwrap();
        let schema = Schema::parse(text).ok();
        assert_eq!(
            schema.as_ref().map(Schema::hash),
            vector["hash"].as_u64(),
            "{}",
            vector["name"]
        );
        if let Some(schema) = schema {
            assert_eq!(schema.to_string(), text);
        }
    }
}
