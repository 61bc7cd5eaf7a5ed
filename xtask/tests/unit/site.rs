use super::interface_bytes;

#[test]
fn bytes_of_an_interface_are_those_received_and_sent() {
    let line = "    r0: 1000 10 0 0 0 0 0 0 2500 20 0 0 0 0 0 0";
    assert_eq!(interface_bytes(line), Some(3500));
    assert_eq!(interface_bytes(&line.replace("r0", "lo")), None);
    assert_eq!(interface_bytes("Inter-|   Receive                |  Transmit"), None);
    assert_eq!(interface_bytes("    r0: 1000"), None);
}
