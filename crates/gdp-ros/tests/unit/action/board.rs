//! Unit tests of `action::board`.

use super::*;

fn status(goal: u8, status: i8) -> Status {
    Status { goal: [goal; 16], stamp: (1, 2), status }
}

fn shown(board: &Board) -> Vec<(u8, i8)> {
    statuses(&board.message()).unwrap().iter().map(|status| (status.goal[0], status.status)).collect()
}

#[test]
fn goals_of_all_servers_are_shown_and_those_of_lost_ones_as_aborted() {
    let [one, two] = [1, 2].map(|number| Name::from_bytes([number; 32]));
    let (mut board, start) = (Board::default(), Instant::now());
    assert_eq!(board.say(one, &status_array(&[status(1, 2), status(2, 4)])), Ok(vec![status(2, 4)]));
    assert_eq!(board.say(two, &status_array(&[status(3, 2)])), Ok(vec![]));
    assert_eq!(shown(&board), [(1, 2), (2, 4), (3, 2)]);
    assert!(board.leave(start, &one) && !board.leave(start, &one));
    assert_eq!(shown(&board), [(1, 6), (2, 4), (3, 2)]);
    assert!(!board.sweep(start) && board.sweep(start + LINGER));
    assert_eq!(shown(&board), [(3, 2)]);
    assert_eq!(board.say(one, b"junk"), Err(Malformed));
}

#[test]
fn servers_that_left_are_bounded() {
    let (mut board, start) = (Board::default(), Instant::now());
    for number in 0..MAX_LEFT as u8 + 3 {
        let server = Name::from_bytes([number; 32]);
        board.say(server, &status_array(&[status(number, 2)])).unwrap();
        board.leave(start, &server);
    }
    assert_eq!(shown(&board).len(), MAX_LEFT);
}
