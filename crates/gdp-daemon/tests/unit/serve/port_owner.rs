//! Unit tests of `serve::port_owner`.

use super::*;

#[test]
fn a_port_that_is_taken_is_said_with_its_process() {
    let socket = UdpSocket::bind("127.0.0.1:0").unwrap();
    let addr = socket.local_addr().unwrap();
    let error = expect_free(addr).unwrap_err().to_string();
    let process = format!("process {} (", std::process::id());
    assert!(error.contains(&process) && error.contains(&addr.to_string()) && error.contains("`udp:`"), "{error}");
    drop(socket);
    assert!(expect_free(addr).is_ok());
    assert_eq!(find(0), None);
}

#[test]
fn a_table_of_the_kernel_is_read() {
    let table = "   sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode ref\n  \
                 91: 00000000:7AB7 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 12345 2 0\n  \
                 92: 0100007F:0035 00000000:0000 07 00000000:00000000 00:00000000 00000000     0        0 678 2 0\n junk\n";
    assert_eq!(sockets(table, 31415).collect::<Vec<_>>(), ["12345"]);
    assert_eq!(sockets(table, 53).collect::<Vec<_>>(), ["678"]);
    assert_eq!(sockets(table, 54).count(), 0);
}
