//! Unit tests of `ros2::service::mapping`.

use super::*;

#[test]
fn a_header_comes_off_as_it_was_put_on_in_either_byte_order() {
    for encapsulation in [[0, 1, 0, 0], [0, 0, 0, 0]] {
        let sample = RawSample::parse([&encapsulation[..], b"body"].concat().into()).unwrap();
        let header: [u8; HEADER] = std::array::from_fn(|i| i as u8);
        let whole = with_header(&sample, header);
        assert_eq!(whole.bytes[4] == 0, encapsulation[1] == 1, "the words are in the message's byte order");
        assert_eq!(behead(whole), Ok((RequestId(Id::Header(header)), sample)));
    }
    let short = RawSample::parse(Bytes::from_static(&[0, 1, 0, 0, 1, 2, 3])).unwrap();
    assert_eq!(behead(short), Err(Headless(Mapping::Cyclone)));
}

#[test]
fn the_vendor_in_a_guid_tells_the_mapping() {
    let guid = |vendor: [u8; 2]| std::array::from_fn(|i| *vendor.get(i).unwrap_or(&7));
    assert_eq!(Mapping::of(guid([1, 0x10])), Mapping::Cyclone);
    assert_eq!(Mapping::of(guid([1, 0x0f])), Mapping::Enhanced);
    assert_eq!(Mapping::of(guid([1, 0x12])), Mapping::Enhanced);
}
