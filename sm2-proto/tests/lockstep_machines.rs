//! The conductor and the member of a lockstep: refusals, limits, and the owner's mistakes. `verification/` explores
//! them together.

// Shows LCK-NOFALSE, LCK-INPUTS, LCK-REST (test), bound: tables and limits of both machines.

use sm2_proto::clock::DomainTime;
use sm2_proto::limits::{LOCKSTEP_MEMBERS_MAX, LOCKSTEP_ROUNDS_MAX};
use sm2_proto::lockstep::{
    Conductor, Done, IllegalTurn, Input, Member, MemberInput, MemberMisuse, MemberOutput, Misuse,
    Output, Refused, TooManyRounds, Turn,
};
use sm2_proto::{Error, Instant, Machine, Name};

fn name(text: &str) -> Name {
    Name::new(text).unwrap()
}

fn done(step: u64, round: u64, taken: u64) -> Done {
    Done {
        step,
        round,
        taken,
        next: None,
    }
}

fn turn(step: u64, round: u64, time: u64, cut: u64) -> Turn {
    Turn {
        step,
        round,
        time: DomainTime(time),
        cut: Instant(cut),
    }
}

/// Feeds an input at a moment, and returns the outputs.
fn feed(conductor: &mut Conductor, now: u64, input: Input) -> Vec<Output> {
    conductor.handle(Instant(now), input).unwrap();
    outputs(conductor)
}

fn outputs(conductor: &mut Conductor) -> Vec<Output> {
    std::iter::from_fn(|| conductor.poll()).collect()
}

fn called(text: &str, call: Done) -> Input {
    Input::Called(name(text), call)
}

/// A conductor whose two members have the first turn, which began at the moment 10.
fn working() -> Conductor {
    let mut conductor = Conductor::new();
    for member in ["a", "b"] {
        assert_eq!(feed(&mut conductor, 1, called(member, Done::JOIN)), []);
    }
    let first = turn(1, 0, 100, 10);
    let turns = ["a", "b"].map(|it| Output::Turn(name(it), first));
    assert_eq!(
        feed(&mut conductor, 10, Input::Step(DomainTime(100))),
        turns
    );
    conductor
}

//= SM2-LCK-002, SM2-LCK-003, SM2-LCK-004 test
#[test]
fn rounds_follow_until_no_member_takes_anything() {
    let mut conductor = working();
    assert_eq!(feed(&mut conductor, 20, called("a", done(1, 0, 0))), []);
    let next = turn(1, 1, 100, 30);
    let turns = ["a", "b"].map(|it| Output::Turn(name(it), next));
    assert_eq!(feed(&mut conductor, 30, called("b", done(1, 0, 1))), turns);
    // A member that joins meanwhile gets no turn of this step.
    assert_eq!(feed(&mut conductor, 35, called("c", Done::JOIN)), []);
    let timer = Done {
        next: Some(DomainTime(150)),
        ..done(1, 1, 0)
    };
    assert_eq!(feed(&mut conductor, 40, called("b", timer)), []);
    assert_eq!(conductor.working().collect::<Vec<_>>(), [&name("a")]);
    let ended = feed(&mut conductor, 50, called("a", done(1, 1, 0)));
    assert_eq!(ended, [Output::StepEnded]);
    assert!(!conductor.is_running());
    assert_eq!(conductor.next(), Some(DomainTime(150)));
    assert_eq!(
        feed(&mut conductor, 60, Input::Step(DomainTime(150))).len(),
        3
    );
}

#[test]
fn a_step_without_members_is_over_at_once() {
    let mut conductor = Conductor::new();
    let ended = feed(&mut conductor, 1, Input::Step(DomainTime(5)));
    assert_eq!(ended, [Output::StepEnded]);
}

//= SM2-LCK-007 test
#[test]
fn the_round_goes_on_without_members_that_leave() {
    let mut conductor = working();
    assert_eq!(feed(&mut conductor, 20, called("a", done(1, 0, 0))), []);
    let ended = feed(&mut conductor, 30, Input::Left(name("b")));
    assert_eq!(ended, [Output::StepEnded]);
    assert_eq!(conductor.members(), 1);

    // A call about another turn.
    let mut conductor = working();
    let (step, round) = (1, 1);
    let refused = Output::Refuse(name("a"), Refused::OtherTurn { step, round });
    assert_eq!(
        feed(&mut conductor, 20, called("a", done(1, 1, 0))),
        [refused]
    );
    let ended = feed(&mut conductor, 30, called("b", done(1, 0, 0)));
    assert_eq!(ended, [Output::StepEnded]);

    // A second call while the first one waits.
    let refused = Refused::OtherTurn { step: 1, round: 0 };
    let answers = feed(&mut conductor, 40, called("b", done(1, 0, 0)));
    let expected = [
        Output::Superseded(name("b")),
        Output::Refuse(name("b"), refused),
    ];
    assert_eq!(answers, expected);

    // A node that was started again.
    let mut conductor = working();
    assert_eq!(feed(&mut conductor, 20, called("a", Done::JOIN)), []);
    let again = feed(&mut conductor, 20, called("a", Done::JOIN));
    assert_eq!(again, [Output::Superseded(name("a"))]);
    let ended = feed(&mut conductor, 30, called("b", done(1, 0, 0)));
    assert_eq!(ended, [Output::StepEnded]);
    assert_eq!(
        feed(&mut conductor, 40, Input::Step(DomainTime(101))).len(),
        2
    );
}

//= SM2-LCK-010 test
#[test]
fn the_number_of_members_is_bounded() {
    let mut conductor = Conductor::new();
    for number in 0..LOCKSTEP_MEMBERS_MAX {
        let member = format!("m{number}");
        assert_eq!(feed(&mut conductor, 1, called(&member, Done::JOIN)), []);
    }
    let refused = Output::Refuse(name("late"), Refused::Members);
    assert_eq!(
        feed(&mut conductor, 1, called("late", Done::JOIN)),
        [refused]
    );
    assert_eq!(conductor.members(), LOCKSTEP_MEMBERS_MAX);
    // A member can take its own place.
    let again = feed(&mut conductor, 1, called("m0", Done::JOIN));
    assert_eq!(again, [Output::Superseded(name("m0"))]);
}

//= SM2-LCK-009 test
#[test]
fn a_step_without_end_ends_the_conductor() {
    let mut conductor = Conductor::new();
    feed(&mut conductor, 1, called("a", Done::JOIN));
    feed(&mut conductor, 1, Input::Step(DomainTime(0)));
    for round in 0..LOCKSTEP_ROUNDS_MAX - 1 {
        assert_eq!(
            feed(&mut conductor, round + 2, called("a", done(1, round, 1))).len(),
            1
        );
    }
    let last = called("a", done(1, LOCKSTEP_ROUNDS_MAX - 1, 1));
    let ended = Err(Error::Ended(TooManyRounds { step: 1 }));
    assert_eq!(conductor.handle(Instant(u64::MAX), last), ended);
    assert_eq!(outputs(&mut conductor), []);
    assert_eq!(
        conductor.handle(Instant(u64::MAX), Input::Left(name("a"))),
        ended
    );
}

//= SM2-LCK-002 test
#[test]
fn the_owner_begins_one_step_at_a_time_and_never_goes_back() {
    let mut conductor = working();
    let before = conductor.clone();
    let running = conductor.handle(Instant(20), Input::Step(DomainTime(200)));
    assert_eq!(running, Err(Error::Misuse(Misuse::Running { step: 1 })));
    assert_eq!(conductor, before);
    for member in ["a", "b"] {
        feed(&mut conductor, 30, called(member, done(1, 0, 0)));
    }
    let back = conductor.handle(Instant(40), Input::Step(DomainTime(99)));
    assert_eq!(back, Err(Error::Misuse(Misuse::Back)));
    assert_eq!(
        feed(&mut conductor, 40, Input::Step(DomainTime(100))).len(),
        2
    );
}

/// A member that waits for its first turn.
fn joined() -> Member {
    let mut member = Member::new();
    member.handle(Instant(0), MemberInput::Found).unwrap();
    assert_eq!(member.poll(), Some(MemberOutput::Call(Done::JOIN)));
    member
}

/// A member that has finished this turn.
fn finished(turn: Turn) -> Member {
    let mut member = joined();
    member.handle(Instant(0), MemberInput::Turn(turn)).unwrap();
    assert_eq!(member.poll(), Some(MemberOutput::Work(turn)));
    assert_eq!(member.turn(), Some(turn));
    let finish = MemberInput::Finished {
        taken: 7,
        next: Some(DomainTime(9)),
    };
    member.handle(Instant(0), finish).unwrap();
    let call = Done {
        next: Some(DomainTime(9)),
        ..done(turn.step, turn.round, 7)
    };
    assert_eq!(member.poll(), Some(MemberOutput::Call(call)));
    member
}

//= SM2-LCK-001, SM2-LCK-008 test
#[test]
fn a_member_accepts_legal_turns_alone() {
    let last = turn(5, 2, 100, 10);
    for (turn, legal) in [
        (turn(5, 3, 100, 11), true),
        (turn(6, 0, 100, 11), true),
        (turn(9, 0, 200, 11), true),
        // The round, the step, the time, the cut.
        (turn(5, 2, 100, 11), false),
        (turn(5, 4, 100, 11), false),
        (turn(5, 0, 100, 11), false),
        (turn(6, 1, 100, 11), false),
        (turn(4, 0, 100, 11), false),
        (turn(5, 3, 101, 11), false),
        (turn(6, 0, 99, 11), false),
        (turn(5, 3, 100, 10), false),
        (turn(6, 0, 100, 9), false),
    ] {
        // The member got to round 2 without the checks of the rounds before.
        let mut member = finished(self::turn(5, 0, 100, 8));
        for round in 1..=2 {
            let cut = 8 + round;
            let next = self::turn(5, round, 100, cut);
            member.handle(Instant(0), MemberInput::Turn(next)).unwrap();
            member.poll();
            let finish = MemberInput::Finished {
                taken: 0,
                next: None,
            };
            member.handle(Instant(0), finish).unwrap();
            member.poll();
        }
        assert_eq!(last, self::turn(5, 2, 100, 10));
        let result = member.handle(Instant(0), MemberInput::Turn(turn));
        let end = Err(Error::Ended(IllegalTurn { turn }));
        assert_eq!(result, if legal { Ok(()) } else { end }, "{turn:?}");
        if !legal {
            assert_eq!(member.handle(Instant(0), MemberInput::Failed), end);
            assert_eq!(member.poll(), None);
        }
    }
    for (turn, legal) in [
        (turn(1, 0, 0, 0), true),
        (turn(8, 0, 50, 3), true),
        (turn(0, 0, 0, 1), false),
        (turn(1, 1, 0, 1), false),
    ] {
        let result = joined().handle(Instant(0), MemberInput::Turn(turn));
        assert_eq!(result.is_ok(), legal, "{turn:?}");
    }
}

#[test]
fn a_member_whose_call_fails_is_free_and_joins_again() {
    let mut member = finished(turn(5, 0, 100, 10));
    member.handle(Instant(0), MemberInput::Failed).unwrap();
    assert!(member.is_free());
    member.handle(Instant(0), MemberInput::Found).unwrap();
    assert_eq!(member.poll(), Some(MemberOutput::Call(Done::JOIN)));
    // Another conductor may begin anywhere.
    let first = turn(1, 0, 3, 2);
    member.handle(Instant(0), MemberInput::Turn(first)).unwrap();
    assert_eq!(member.turn(), Some(first));
}

#[test]
fn inputs_that_do_not_fit_the_state_change_nothing() {
    let finish = MemberInput::Finished {
        taken: 0,
        next: None,
    };
    let any_turn = MemberInput::Turn(turn(1, 0, 0, 1));
    let mut working = joined();
    working.handle(Instant(0), any_turn).unwrap();
    working.poll();
    let cases = [
        (Member::new(), vec![any_turn, finish, MemberInput::Failed]),
        (joined(), vec![MemberInput::Found, finish]),
        (
            working,
            vec![MemberInput::Found, any_turn, MemberInput::Failed],
        ),
    ];
    for (member, inputs) in cases {
        for input in inputs {
            let mut changed = member.clone();
            let result = changed.handle(Instant(0), input);
            assert_eq!(
                result,
                Err(Error::Misuse(MemberMisuse)),
                "{input:?} in {member:?}"
            );
            assert_eq!(changed, member);
        }
    }
}
