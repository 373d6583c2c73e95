; `unsound` returns whether any of n >= $lanes numbers is not finite (x - x is 0 for every finite x). It adds up four
; sums side by side, because each addition waits for the one before; the last numbers may be added twice. `blank` writes
; NaN.

declare i64 @llvm.smin.i64(i64, i64)

define internal i1 @unsound(ptr %x, i64 %n) noinline nounwind {
entry:
  %end = sub i64 %n, $lanes
  br label %next

next:
  %e = phi i64 [ 0, %entry ], [ %e.next, %next ]
  %sum0 = phi $T [ $zero, %entry ], [ %sum0.next, %next ]
  %sum1 = phi $T [ $zero, %entry ], [ %sum1.next, %next ]
  %sum2 = phi $T [ $zero, %entry ], [ %sum2.next, %next ]
  %sum3 = phi $T [ $zero, %entry ], [ %sum3.next, %next ]
  %e0 = add i64 %e, ${step0}
  %i0 = call i64 @llvm.smin.i64(i64 %e0, i64 %end)
  %at0 = getelementptr double, ptr %x, i64 %i0
  %v0 = load $T, ptr %at0, align 8
  %d0 = fsub $T %v0, %v0
  %sum0.next = fadd $T %sum0, %d0
  %e1 = add i64 %e, ${step1}
  %i1 = call i64 @llvm.smin.i64(i64 %e1, i64 %end)
  %at1 = getelementptr double, ptr %x, i64 %i1
  %v1 = load $T, ptr %at1, align 8
  %d1 = fsub $T %v1, %v1
  %sum1.next = fadd $T %sum1, %d1
  %e2 = add i64 %e, ${step2}
  %i2 = call i64 @llvm.smin.i64(i64 %e2, i64 %end)
  %at2 = getelementptr double, ptr %x, i64 %i2
  %v2 = load $T, ptr %at2, align 8
  %d2 = fsub $T %v2, %v2
  %sum2.next = fadd $T %sum2, %d2
  %e3 = add i64 %e, ${step3}
  %i3 = call i64 @llvm.smin.i64(i64 %e3, i64 %end)
  %at3 = getelementptr double, ptr %x, i64 %i3
  %v3 = load $T, ptr %at3, align 8
  %d3 = fsub $T %v3, %v3
  %sum3.next = fadd $T %sum3, %d3
  %e.next = add i64 %e, $step4
  %more = icmp slt i64 %e.next, %n
  br i1 %more, label %next, label %done

done:
  %a = fadd $T %sum0.next, %sum1.next
  %b = fadd $T %sum2.next, %sum3.next
  %sum = fadd $T %a, %b
  %odd = fcmp une $T %sum, $zero
  %any = $any_odd
  ret i1 %any
}

define internal void @blank(ptr %x, i64 %n) noinline nounwind {
entry:
  br label %next

next:
  %e = phi i64 [ 0, %entry ], [ %e.next, %next ]
  %at = getelementptr double, ptr %x, i64 %e
  store double $nan, ptr %at, align 8
  %e.next = add i64 %e, 1
  %more = icmp slt i64 %e.next, %n
  br i1 %more, label %next, label %done

done:
  ret void
}
